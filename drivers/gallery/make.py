"""The pictures of docs/gallery.md, each with the scene that made it.

    python drivers/gallery/make.py -o results/gallery                  all pictures
    python drivers/gallery/make.py -o results/gallery --only clip      some of them
    python drivers/gallery/make.py -o results/gallery --publish docs   and docs/gallery.md with its pictures

A scene is a file of `drivers/examples` or `drivers/gallery` whose head has the command that makes its mesh. Mesh, run
and picture are made by the commands that the page has, one after the other, in one process each; on one rank.
"""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from PIL import Image

from drivers._common import log, main, make_parser
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI

ROOT = Path(__file__).resolve().parents[2]
SIZE = "1200x750"
# of a picture of the page: pixels across, and bytes at most
WIDTH, BYTES = 900, 60_000
MESH = re.compile(r"^#\s+python -m meshes (.+) -o \S+$", re.MULTILINE)


class Picture(NamedTuple):
    """A picture: its name, its scene below drivers/, what it shows, options of the run and of the view."""

    name: str
    scene: str
    title: str
    text: str
    view: str
    run: str = ""


PICTURES = (
    Picture(
        "press", "examples/press", "A ball on a block",
        "Equivalent stress, cut open at the contact.",
        "-field equivalent_stress",
    ),
    Picture(
        "pressure", "examples/press", "The contact pressure of the ball",
        "The bodies are seen through; on the right the contact surface from above.",
        "-field contact_pressure",
    ),
    Picture(
        "cylinders", "gallery/cylinders", "Two cylinders",
        "Hertz's problem: the stress is largest below the surface.",
        "-field equivalent_stress -views whole,near",
    ),
    Picture(
        "axisymmetric", "examples/axisymmetric", "A rigid ball on an elastic block",
        "Axial symmetry, near the contact: x is the radius.",
        "-field equivalent_stress -views near",
    ),
    Picture(
        "indentation", "examples/indentation", "A plastic imprint",
        "The plastic strain when the ball is deepest, near the contact.",
        "-field equivalent_plastic_strain -views near -step 6",
    ),
    Picture(
        "friction", "gallery/friction", "A block is drawn along another one",
        "Friction: in this load step a part of the points sticks, the others slide already.",
        "-field status -step 9",
    ),
    Picture(
        "shrink_fit", "examples/shrink_fit", "A shrink fit",
        "The overlap of two rings is pushed apart; hoop and radial stress make the equivalent stress "
        "largest at the inner side of each ring.",
        "-field equivalent_stress -scale 1",
    ),
    Picture(
        "bimetal", "examples/bimetal", "A bimetal",
        "Two metals that are glued together bend when they are heated.",
        "-field stress_xx",
    ),
    Picture(
        "obstacle", "examples/obstacle", "A roller bends a beam",
        "The roller is rigid and has no mesh.",
        "-field stress_xx -scale 10",
    ),
    Picture(
        "self_contact", "examples/self_contact", "A slit ring closes",
        "Self contact of the lips of the slit.",
        "-field equivalent_stress",
    ),
    Picture(
        "ring", "gallery/ring", "A rubber ring under a plate",
        "A quarter of the ring, flattened to half its height.",
        "-field equivalent_stress",
    ),
    Picture(
        "seal", "gallery/seal", "A seal is squeezed shut",
        "Self contact, three rigid walls, large strain.",
        "-field equivalent_stress",
    ),
    Picture(
        "rings", "gallery/rings", "A heap of rubber rings",
        "Loose bodies that only contact holds.",
        "-field equivalent_stress",
    ),
    Picture(
        "balls", "gallery/balls", "A heap of balls",
        "The same in space.",
        "-field displacement_z -cut false",
    ),
    Picture(
        "clip", "gallery/clip", "A snap fit",
        "The hook on top of the catch, where its root is bent most.",
        "-field equivalent_stress -step 32",
    ),
    Picture(
        "ironing", "gallery/ironing", "A slab irons a foundation",
        "Both are of rubber. The slab was pressed down and has been drawn to the right, with friction.",
        "-field stress_xy",
    ),
    Picture(
        "billet", "gallery/billet", "A billet is upset",
        "Plastic strain of a quarter of the section; the side has folded onto the die.",
        "-field equivalent_plastic_strain",
    ),
    Picture(
        "hemisphere", "gallery/hemisphere", "A hemisphere turns on a cube",
        "Friction drags the cube along.",
        "-field displacement",
    ),
    Picture(
        "pad", "gallery/pad", "A pad on a ring that turns",
        "The ring has turned by 40 degrees and has dragged the pad, which is held at its top.",
        "-field displacement -cut false",
    ),
    Picture(
        "punch", "gallery/punch", "A mesh for a named error",
        "Half a punch with sharp corners. pcontact has refined the mesh, most of all at the corner, until the "
        "error was "
        "below 10 %.",
        "-field equivalent_stress -scale 1 -smooth false",
    ),
)  # fmt: skip


def commands(picture, folder, scene_folder=None):
    """The three commands of a picture: mesh, run, view.

    Parameters
    ----------
    picture : Picture
    folder : Path
        Of results and pictures.
    scene_folder : Path, optional
        Where scene and mesh are; absent: below drivers/.
    """
    scene = ROOT / "drivers" / f"{picture.scene}.toml"
    mesh = MESH.search(scene.read_text(encoding="utf-8"))
    place = Path("drivers") / Path(picture.scene).parent if scene_folder is None else scene_folder
    results = folder / picture.scene.rpartition("/")[2]
    return [
        f"python -m meshes {mesh[1]} -o {place / scene.stem}.msh",
        f"pcontact run {place / scene.name} {picture.run + ' ' if picture.run else ''}-o {results}",
        f"pcontact view {results} {picture.view} -size {SIZE} -o {folder / picture.name}.jpg",
    ]


def make(picture, folder, done, keep=False):
    """Make a picture in a folder; the words of its failure, or "".

    Parameters
    ----------
    picture : Picture
    folder : Path
    done : set of str
        Commands that have been run before, and are not run again.
    keep : bool
        A run that has ended is not done again.
    """
    scenes = folder / "scenes"
    scenes.mkdir(parents=True, exist_ok=True)
    shutil.copy(ROOT / "drivers" / f"{picture.scene}.toml", scenes)
    every = commands(picture, folder, scenes)
    kept = keep and (folder / picture.scene.rpartition("/")[2] / "report.json").exists()
    for command in every[2:] if kept else every:
        if command in done:
            continue
        words = shlex.split(command)
        words = words[1:] if words[0] == "python" else ["-m", *words]
        ended = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True)
        if ended.returncode:
            return f"{command}: {ended.stderr.strip() or ended.stdout.strip()}"
        done.add(command)
    return ""


def shrink(source, target):
    """Write a picture `WIDTH` wide, with the best quality that stays below `BYTES`."""
    with Image.open(source) as large:
        picture = large.resize((WIDTH, round(large.height * WIDTH / large.width)), Image.Resampling.LANCZOS)
        for quality in range(90, 40, -5):
            picture.save(target, quality=quality, optimize=True)
            if target.stat().st_size < BYTES:
                return


def page():
    """The text of docs/gallery.md."""
    lines = [
        "# Gallery", "",
        "Each picture has the commands that make it, typed in the repository's directory after `. scripts/env.sh`; "
        "`python drivers/gallery/make.py` makes all of them.",
        "A page in which the bodies can be turned: `-o NAME.html` in place of `-o NAME.jpg`; an animation of all load",
        "steps: `-o NAME.gif` or `-o NAME.mp4`",
        "([the command line](command_line.md)).",
    ]  # fmt: skip
    for one in PICTURES:
        lines += ["", f"## {one.title}", "", f"![{one.title}](gallery/{one.name}.jpg)", "", one.text, "", "```sh",
                  *commands(one, Path("results")), "```"]  # fmt: skip
    return "\n".join(lines) + "\n"


def run(args):
    """Make pictures; 1 when one fails."""
    names = [one.name for one in PICTURES]
    if unknown := set(args.only or names) - set(names):
        raise InputError(f"command line: --only: found {', '.join(sorted(unknown))}; allowed: {', '.join(names)}")
    if MPI.COMM_WORLD.size > 1:
        raise InputError(f"command line: found {MPI.COMM_WORLD.size} ranks; allowed: one")
    wanted = [one for one in PICTURES if one.name in (args.only or names)]
    done, status = set(), 0
    for one in wanted:
        failure = make(one, args.o.resolve(), done, args.keep)
        log.info("%s: %s", one.name, failure or f"{(args.o / f'{one.name}.jpg').stat().st_size / 1000:.0f} kB")
        status = status or int(bool(failure))
    if args.publish is not None and not status:
        (args.publish / "gallery").mkdir(exist_ok=True)
        for one in wanted:
            shrink(args.o / f"{one.name}.jpg", args.publish / "gallery" / f"{one.name}.jpg")
        (args.publish / "gallery.md").write_text(page(), encoding="utf-8")
    return status


if __name__ == "__main__":
    parser = make_parser(__doc__, "results/gallery", tiny=False)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these pictures")
    parser.add_argument("--keep", action="store_true", help="pictures alone are drawn anew, of runs that are there")
    parser.add_argument("--publish", type=Path, metavar="DIR", help="where gallery.md and its pictures go")
    main(run, parser)
