#!/usr/bin/env python3
"""Compare imported decks with CalculiX: displacements at the nodes, in the discrete L2 norm.

    python scripts/compare_ccx.py DECK.inp ... [--ccx PATH] [--stiff X] [--work DIR] [--seconds N]

Every deck is imported and run, and run by `ccx`, which writes the displacements of its last increment into a .frd file.
The table has for each deck what the import says, whether both runs end, and the difference over all nodes of the deck,
|u - u_ccx| / |u_ccx|. `--stiff X` gives `ccx` springs of contact that are X times as stiff as in the deck: the program
leaves no overlap.
"""

import argparse
import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from pcontact.importer.deck import read_deck
from pcontact.importer.elements import in_plane
from pcontact.importer.write import LIST, SCENE, import_file
from pcontact.io.result import load_result
from pcontact.runtime.errors import InputError

WIDTH = 12  # letters of a number in a .frd file


def for_ccx(deck, target, stiff):
    """Copy a deck, with displacements in the .frd file and other springs of contact."""
    plane = all(in_plane(deck.elements[e][0]) for e in deck.cells())
    lines, slope = [], False
    for line in deck.path.read_text(encoding="utf-8", errors="replace").splitlines():
        word = "".join(line.split()).upper()
        if word.startswith("*ENDSTEP"):
            lines += [f"*NODE FILE{', OUTPUT=2D' if plane else ''}", "U"]
        if slope and not word.startswith("*") and stiff != 1.0:
            first, *rest = line.split(",")
            line, slope = ",".join([repr(stiff * float(first)), *rest]), False
        if word.startswith("*SURFACEBEHAVIOR"):
            slope = "OVERCLOSURE=LINEAR" in word
        lines.append(line)
    target.write_text("\n".join([*lines, ""]))


def read_frd(path):
    """Displacements of the last increment in a .frd file, {node: (3,)}."""
    found, block = {}, None
    for line in path.read_text().splitlines():
        if line.startswith(" -4"):
            block = {} if line.split()[1] == "DISP" else None
        elif line.startswith(" -1") and block is not None:
            numbers = [line[13 + WIDTH * k : 13 + WIDTH * (k + 1)] for k in range(3)]
            block[int(line[3:13])] = np.array([float(n) if n.strip() else 0.0 for n in numbers])
        elif line.startswith(" -3") and block is not None:
            found, block = block, None
    return found


def run_ccx(deck, folder, options):
    """Displacements by `ccx`, or why there are none."""
    for_ccx(deck, folder / "deck.inp", options.stiff)
    try:
        words = [options.ccx, "-i", "deck"]
        ended = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=options.seconds)
    except subprocess.TimeoutExpired:
        return f"ccx: not within {options.seconds} s"
    frd = folder / "deck.frd"
    found = read_frd(frd) if frd.exists() else {}
    said = re.findall(r"\*ERROR[^\n]*", ended.stdout)
    if said or not found or "Job finished" not in ended.stdout:
        return f"ccx: {said[0].strip() if said else 'no displacements'}"
    return found


def run_ours(deck, folder, options):
    """Displacements by the program, or why there are none."""
    words = [sys.executable, "-m", "pcontact", "run", str(folder / SCENE), "-o", str(folder / "results")]
    try:
        ended = subprocess.run(words, capture_output=True, text=True, timeout=options.seconds)
    except subprocess.TimeoutExpired:
        return f"not within {options.seconds} s"
    if ended.returncode:
        return (ended.stdout + ended.stderr).strip().splitlines()[-1][:150]
    bodies = load_result(folder / "results").bodies
    used = sorted({node for e in deck.cells() for node in deck.elements[e][1]})
    # nodes come in the order of their numbers; those that the program has added are the last
    places = np.array([deck.nodes[node] for node in used])
    if not np.allclose(bodies.points[: len(used)], places, atol=1e-6 * np.ptp(places, axis=0).max()):
        return "nodes of the results are not those of the deck"
    return dict(zip(used, bodies.point_data["displacement"], strict=False))


def compare(path, options):
    """One row of the table."""
    folder = options.work / path.stem
    try:
        deck = read_deck(path)
        status = import_file(path, folder)
    except InputError as error:
        return [path.stem, "no", "", "", str(error)]
    text = (folder / LIST).read_text()
    part = text.partition("\nleft out (")[2].partition("\nchanged (")[0].splitlines()[1:2] if status else []
    remark = part[0].strip() if part else ""
    if status and not options.all:
        return [path.stem, "in part", "", "", remark]
    own = run_ours(deck, folder, options)
    if isinstance(own, str):
        return [path.stem, "in part" if status else "yes", "no", "", own]
    other = run_ccx(deck, folder, options)
    if isinstance(other, str):
        return [path.stem, "in part" if status else "yes", "yes", "", other]
    nodes = sorted(own.keys() & other.keys())
    a, b = (np.array([of[n] for n in nodes]) for of in (own, other))
    difference = np.linalg.norm(a - b) / max(np.linalg.norm(b), 1e-300)
    return [path.stem, "in part" if status else "yes", "yes", f"{100.0 * difference:.3g} %", remark]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("decks", nargs="+", type=Path)
    parser.add_argument("--ccx", default="ccx", help="the program, by its path")
    parser.add_argument("--stiff", type=float, default=1.0, help="factor of the springs of contact in ccx")
    parser.add_argument("--work", type=Path, default=Path("compare_ccx"), help="where the runs go")
    parser.add_argument("--seconds", type=float, default=300.0, help="longest run")
    parser.add_argument("--all", action="store_true", help="decks of which something is left out, too")
    options = parser.parse_args()
    print("| deck | imports | runs | difference | |\n|---|---|---|---|---|")
    for path in options.decks:
        print("| " + " | ".join(compare(path, options)) + " |", flush=True)


if __name__ == "__main__":
    main()
