#!/usr/bin/env python3
"""Compare imported decks with CalculiX: displacements at the nodes, in the discrete L2 norm.

    python scripts/compare_ccx.py DECK.inp|FOLDER ... [--stiff X] [--refine N] [--work DIR] [--seconds N] [-o FILE]
                                  [--update]

Of a folder all decks with a contact pair are taken. Decks with steps that are not static, or with elements that are no
cells of a solid, are named with that reason. Every other is imported and run, and run by `ccx`, which writes the
displacements of its last increment into a .frd file; where `ccx` does not end, DECK.frd.ref beside the deck stands in.
The table has for each deck what is in it, what the import says, whether the program's run ends, and the difference over
all nodes of the deck, |u - u_ccx| / |u_ccx|. `--stiff X` makes X times as stiff what `ccx` has of linear springs of
contact, and of springs where friction sticks: the program leaves no overlap; springs that the scene has, too, stay as
they are. `--refine N` refines a deck up to N times where the difference is beyond 1 %, for both programs; how often
stands in brackets. Decks of which something was left out are run only with `--all`. With `--update` the rows of other
decks stay in FILE as they are.
"""

import argparse
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from refine_deck import refine

from pcontact.importer.deck import in_plane, kind_of, read_deck
from pcontact.importer.materials import bodies, materials
from pcontact.importer.steps import PROCEDURES, Presence
from pcontact.importer.translate import LIST, SCENE, Findings, import_file
from pcontact.io.result import load_result
from pcontact.runtime.errors import InputError
from pcontact.scene.reader import read_scene

WIDTH = 12  # letters of a number in a .frd file
HEAD = ["deck", "what is in it", "imported", "runs", "difference", "refined", "remark"]
FIRMNESS = 50.0  # [1 / length] springs of HARD in ccx over the modulus
AGREE = 0.01  # largest difference that counts as agreement
COMMAND = "scripts/compare_ccx.py"


def decks_of(paths):
    """The decks, and those of folders that have a contact pair; by name."""
    found = []
    for path in paths:
        if not path.is_dir():
            found.append(path)
            continue
        for deck in sorted(path.glob("*.inp")):
            if re.search(r"(?im)^\*contact *pair", deck.read_text(encoding="utf-8", errors="replace")):
                found.append(deck)
    return found


def contents(deck):
    """What is in a deck, and why it is no static one of solids (empty: it is)."""
    elements = sorted(deck.element_cards)
    words = ["/".join(elements), f"{len(deck.nodes)} nodes", f"{len(deck.steps)} step{'s' * (len(deck.steps) != 1)}"]
    words += ["friction"] if any(c.key == "FRICTION" for rows in deck.interactions.values() for c in rows) else []
    words += ["plastic"] if any(c.key == "PLASTIC" for rows in deck.materials.values() for c in rows) else []
    words += ["NLGEOM"] if any("NLGEOM" in step.card.parameters for step in deck.steps) else []
    others = [word for word in elements if kind_of(word).dim == 0]
    procedures = sorted({c.title.upper() for step in deck.steps for c in step.cards if c.key in PROCEDURES})
    reason = f"not static: {', '.join(procedures)}" if procedures else ""
    if others:
        reason = "; ".join(filter(None, [reason, f"no solids: {', '.join(others)}"]))
    return ", ".join(words), reason


def for_ccx(deck, target, stiff):
    """Copy a deck, with displacements in the .frd file and stiffer springs of contact."""
    plane = all(in_plane(deck.elements[e][0]) for e in deck.cells())
    lines, stiffer, drop = [], None, False
    for line in deck.path.read_text(encoding="utf-8", errors="replace").splitlines():
        word = "".join(line.split()).upper()
        if word.startswith("*ENDSTEP"):
            lines += [f"*NODE FILE{', OUTPUT=2D' if plane else ''}", "U"]
        if stiffer is not None and not word.startswith("*") and stiff != 1.0:
            values = line.split(",")
            if len(values) > stiffer and values[stiffer].strip():
                values[stiffer] = repr(stiff * float(values[stiffer]))
            line, stiffer = ",".join(values), None
        elif word.startswith("*") and not word.startswith("**"):
            # the stiffness is the first number of a linear law, the second of a law of friction
            linear = word.startswith("*SURFACEBEHAVIOR") and "OVERCLOSURE=LINEAR" in word
            sticks = word.startswith(("*FRICTION", "*CHANGEFRICTION"))
            stiffer = 0 if linear else 1 if sticks else None
            soft = re.search(r"(?i)(HARD|EXPONENTIAL) *$", line) if word.startswith("*SURFACEBEHAVIOR") else None
            drop = soft is not None and stiff != 1.0
            if drop:
                line = f"{line[: soft.start()]}LINEAR\n{stiff * hard(deck)!r}"
        elif drop and not word.startswith("**"):
            continue
        lines.append(line)
    target.write_text("\n".join([*lines, ""]))


def hard(deck):
    """The stiffness per area that `ccx` has for HARD: 50 times the modulus of the stiffest material."""
    moduli = [
        card.number(*next((place, words[0]) for place, words in card.rows if words[0]))
        for cards in deck.materials.values() for card in cards if card.key == "ELASTIC"
    ]  # fmt: skip
    return FIRMNESS * max(moduli)


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


def run_ccx(deck, folder, options, stiff):
    """Displacements by `ccx`, or why there are none."""
    for_ccx(deck, folder / "deck.inp", stiff)
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
    words = ["mpirun", "-n", str(options.ranks)] if options.ranks > 1 else []
    words += [sys.executable, "-m", "pcontact", "run", str(folder / SCENE), "-o", str(folder / "results")]
    try:
        ended = subprocess.run(words, capture_output=True, text=True, timeout=options.seconds)
    except subprocess.TimeoutExpired:
        return f"not within {options.seconds} s"
    if ended.returncode:
        return (ended.stdout + ended.stderr).strip().splitlines()[-1][:150]
    result = load_result(folder / "results").bodies
    body = np.zeros(len(result.points), dtype=np.int64)
    for (_, nodes), values in zip(result.cells, result.cell_data["body"], strict=True):
        body[nodes] = values[:, None]
    rows = matched(deck, result.points, body)
    if rows is None:
        return "nodes of the results are not those of the deck"
    return {node: result.point_data["displacement"][row] for node, row in rows.items()}


def matched(deck, points, body):
    """Row of every node of a deck among points (n, 3) of bodies (n,), or None.

    A node is known by its place and a body that has it. Surfaces that touch have several nodes in one place: those of a
    body stand in the order of their numbers; one that bodies share is among the points of one of them.
    """
    dim = 2 if all(in_plane(deck.elements[e][0]) for e in deck.cells()) else 3
    places, nodes, found = {}, {}, {}
    for row, (point, number) in enumerate(zip(points.tolist(), body.tolist(), strict=True)):
        places.setdefault((*point[:dim], number), []).append(row)
    for number, (_, _, cells) in enumerate(bodies(deck, Findings(), materials(deck, Findings()))[0]):
        for node in sorted({node for e in cells for node in deck.elements[e][1]}):
            nodes.setdefault((*deck.nodes[node][:dim], number), []).append(node)
    # those of one body alone first: what they leave are the shared ones
    for only in (True, False):
        for key, members in nodes.items():
            rows, left = places.get(key, []), [node for node in members if node not in found]
            if len(rows) == len(members) if only else 0 < len(left) == len(rows):
                found |= dict(zip(members if only else left, rows, strict=True))
    return found if found.keys() == {node for members in nodes.values() for node in members} else None


def remarks(folder):
    """The first line that was left out, else what became of the elements; from the list of the import."""
    text = (folder / LIST).read_text()
    left = text.partition("\nleft out (")[2].partition("\nchanged (")[0].splitlines()[1:]
    left = [line.strip() for line in left if line.startswith("  ")]
    if left:
        return left[0] + (f" (and {len(left) - 1} more)" if len(left) > 1 else "")
    changed = text.partition("\nchanged (")[2].partition("\ntaken (")[0].splitlines()
    found = [line.partition(": ")[2] for line in changed if "*ELEMENT" in line.upper()]
    return found[0].strip() if found else ""


def soft(folder):
    """Whether the scene has the springs of the deck: then `ccx` has them as they are, too."""
    return any(contact.pressure_overclosure is not None for contact in read_scene(folder / SCENE).contacts)


def difference(path, folder, options):
    """The difference of both programs, or why there is none, whether the own program ran, and a remark."""
    deck = read_deck(path)
    Presence(deck, Findings())
    own = run_ours(deck, folder, options)
    if isinstance(own, str):
        return own, False, ""
    other, remark = run_ccx(deck, folder, options, 1.0 if soft(folder) else options.stiff), ""
    if isinstance(other, str):
        reference = path.with_suffix(".frd.ref")
        read = read_frd(reference) if reference.exists() else {}
        if not read.keys() >= own.keys():
            return other, True, ""
        other, remark = read, f"against {reference.name}"
    nodes = sorted(own.keys() & other.keys())
    a, b = (np.array([of[n] for n in nodes]) for of in (own, other))
    return np.linalg.norm(a - b) / max(np.linalg.norm(b), 1e-300), True, remark


def refined(path, folder, options):
    """The difference after as many refinements as take it below the bound, and how many; None where none does."""
    last = None
    for times in range(1, options.refine + 1):
        finer = folder / f"finer{times}.inp"
        refine(path if times == 1 else folder / f"finer{times - 1}.inp", finer)
        inner = folder / f"finer{times}"
        import_file(finer, inner)
        found, _, _ = difference(finer, inner, options)
        if isinstance(found, str):
            break
        last = found, times
        if found <= AGREE:
            break
    return last


def compare(path, options):
    """One row of the table."""
    folder = options.work / path.stem
    try:
        deck = read_deck(path)
        what, reason = contents(deck)
        if reason and not options.all:
            return [path.stem, what, "", "", "", "", reason]
        status = import_file(path, folder)
    except InputError as error:
        return [path.stem, "", "no", "", "", "", str(error).partition(": ")[2]]
    row, remark = [path.stem, what, "in part" if status else "yes"], remarks(folder)
    if status and not options.all:
        return [*row, "", "", "", remark]
    found, ran, more = difference(path, folder, options)
    if isinstance(found, str):
        return [*row, "yes" if ran else "no", "", "", found]
    finer = refined(path, folder, options) if found > AGREE and options.refine else None
    words = "" if finer is None else f"{100.0 * finer[0]:.3g} % ({finer[1]})"
    return [*row, "yes", f"{100.0 * found:.3g} %", words, "; ".join(filter(None, [more, remark]))]


def kept(path):
    """Rows of a table that was written before, by their decks; none without one."""
    lines = path.read_text().splitlines() if path.exists() else []
    rows = [[cell.strip() for cell in line[2:].removesuffix("|").split(" | ")] for line in lines if line[:2] == "| "]
    return {row[0]: row for row in rows if len(row) == len(HEAD) and row != HEAD}


def least(row):
    """The smaller one of the differences of a row, None where there is none."""
    found = [float(cell.split()[0]) / 100.0 for cell in row[4:6] if "%" in cell]
    return min(found) if found else None


def table(rows, options):
    """The page with the table."""
    static, differences = [row for row in rows if row[2]], [least(row) for row in rows]
    counts = [len(rows), len(static), sum(row[2] == "yes" for row in static), sum(row[3] == "yes" for row in static)]
    counts.append(sum(difference is not None for difference in differences))
    counts.append(sum(difference is not None and difference <= AGREE for difference in differences))
    words = (
        "# Contact decks beside CalculiX: table\n\n"
        f"Written by `python {COMMAND} FOLDER -o FILE{options.said}`; what is taken of a deck, and how to read it: "
        "[import.md](../import.md).\n\n"
        "Decks: {}; static and of solids: {}; imported whole: {}; run: {}; compared: {}; within 1 %: {}.\n"
    ).format(*counts)
    lines = [" | ".join(cell.replace("|", "/") for cell in row) for row in rows]
    head = " | ".join(HEAD)
    return "\n".join([words, f"| {head} |", "|---" * len(HEAD) + "|", *[f"| {line} |" for line in lines], ""])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("decks", nargs="+", type=Path, help="decks, or folders of decks")
    parser.add_argument("--ccx", default="ccx", help="the program, by its path")
    parser.add_argument("--stiff", type=float, default=1.0, help="factor of the springs of contact in ccx")
    parser.add_argument("--work", type=Path, default=Path("compare_ccx"), help="where the runs go")
    parser.add_argument("--seconds", type=float, default=300.0, help="longest run")
    parser.add_argument("-n", "--ranks", type=int, default=1, help="ranks of the program")
    parser.add_argument("--jobs", type=int, default=1, help="decks at a time")
    parser.add_argument("-o", "--output", type=Path, help="file of the table; absent: printed only")
    parser.add_argument("--all", action="store_true", help="decks of which something is left out, too")
    parser.add_argument("--update", action="store_true", help="rows of other decks stay in the file of the table")
    parser.add_argument("--refine", type=int, default=0, help="times that decks beyond the bound are refined")
    options = parser.parse_args()
    options.said = f" --seconds {options.seconds:g}" + (f" --stiff {options.stiff:g}" if options.stiff != 1.0 else "")
    options.said += f" --refine {options.refine}" if options.refine else ""
    rows = kept(options.output) if options.update and options.output else {}
    with ThreadPoolExecutor(options.jobs) as pool:
        for row in pool.map(lambda path: compare(path, options), decks_of(options.decks)):
            rows[row[0]] = row
            print(" | ".join(row), flush=True)
            if options.output:
                options.output.write_text(table([rows[name] for name in sorted(rows)], options))


if __name__ == "__main__":
    main()
