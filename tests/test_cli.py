"""The program as the user meets it: bad input of every kind ends with one line and status 2, on every rank.

Most of the time of a run is the start of Python: bad scenes and meshes go through the program one after the
other in one process (per rank); some of them, and what is wrong on the command line, have their own process.
"""

import json
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TIMEOUT = 60

# -- a mesh of two quadrilaterals and its scene ----------------------------------------

NODES = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 1), (1, 1), (1, 2), (0, 2)]
NAMES = {
    (2, 1): "lower",
    (2, 2): "upper",
    (1, 3): "lower_bottom",
    (1, 4): "lower_top",
    (1, 5): "upper_bottom",
    (1, 6): "upper_top",
    (1, 7): "lower_left",
}
# gmsh type, group, nodes, and the entity if it is not the group's
CELLS = [(3, 1, (1, 2, 3, 4)), (3, 2, (5, 6, 7, 8))]
FACETS = [(1, 3, (1, 2)), (1, 4, (3, 4)), (1, 5, (5, 6)), (1, 6, (7, 8)), (1, 7, (4, 1))]
SCENE = """\
title = "two squares"
[mesh]
file = "mesh.msh"
[materials.m]
E = 1000.0
nu = 0.3
[[bodies]]
region = "lower"
material = "m"
[[bodies]]
region = "upper"
material = "m"
[[contacts]]
name = "pair"
source = "upper_bottom"
target = "lower_top"
[[displacements]]
region = "lower_bottom"
value = [0.0, 0.0]
[[displacements]]
region = "upper_top"
value = [0.0, -0.05]
"""


def mesh_text(nodes=None, elements=None, names=None):
    """A gmsh file (MSH 2.2, text)."""
    nodes, names = nodes or NODES, names or NAMES
    elements = elements or CELLS + FACETS
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(names))]
    lines += [f'{dim} {tag} "{name}"' for (dim, tag), name in names.items()]
    lines += ["$EndPhysicalNames", "$Nodes", str(len(nodes))]
    lines += [f"{k + 1} {x} {y} 0" for k, (x, y) in enumerate(nodes)]
    lines += ["$EndNodes", "$Elements", str(len(elements))]
    for k, (kind, group, corners, *entity) in enumerate(elements):
        lines.append(" ".join(map(str, [k + 1, kind, 2, group, *(entity or [group]), *corners])))
    return "\n".join([*lines, "$EndElements", ""])


def swapped(old, new):
    """The scene with one text replaced."""
    assert old in SCENE
    return SCENE.replace(old, new, 1)


# one body of two cells, the facet between them is in a contact surface
INNER = mesh_text(
    NODES[:4] + NODES[6:],
    [
        (3, 1, (1, 2, 3, 4)),
        (3, 2, (4, 3, 5, 6)),
        (1, 3, (1, 2)),
        (1, 4, (3, 4)),
        (1, 5, (3, 4)),
        (1, 6, (5, 6)),
    ],
)


@dataclass
class Case:
    """Input that is wrong.

    Parameters
    ----------
    parts : list of str
        Regular expressions that the line on stderr must match, in any order.
    scene, mesh : str or None
        Contents of the files; None: there is no such file.
    words : list of str
        Command line; SCENE stands for the scene file.
    """

    parts: list
    scene: str | None = SCENE
    mesh: str | None = field(default_factory=mesh_text)
    words: tuple = ("run", "SCENE")


FILES = {
    "no scene": Case([r"scene\.toml", "no such file", "allowed: a scene file"], scene=None),
    "no TOML": Case(
        [r"scene\.toml", r"line \d+, column \d+", "TOML"], scene=swapped("E = 1000.0", "E = = 1")
    ),
    "no mesh": Case([r"scene\.toml", r"mesh\.file", "mesh.msh", "no such file", "allowed"], mesh=None),
    "mesh is something else": Case(
        [r"mesh\.msh", "not a gmsh mesh"], mesh="solid ball\nfacet normal 0 0 1\n"
    ),
    "misspelt key": Case(
        [r"contacts\[0\] \(pair\)\.targte", "unknown key", "'target'", "allowed"],
        scene=swapped("target =", "targte ="),
    ),
    "misspelt table": Case(
        ["displacement", "'displacements'"], scene=SCENE.replace("[[displacements]]", "[[displacement]]")
    ),
    "negative modulus": Case([r"materials\.m\.E", "-1000", "allowed"], scene=swapped("1000.0", "-1000.0")),
    "incompressible": Case([r"materials\.m\.nu", "0.5", "allowed"], scene=swapped("0.3", "0.5")),
    "text for a number": Case(
        [r"materials\.m\.E", "'steel'|\"steel\"", "allowed"], scene=swapped("1000.0", '"steel"')
    ),
    "unknown material": Case(
        [r"bodies\[0\] \(lower\)\.material", "'mm'", "allowed.*m"], scene=swapped('"m"', '"mm"')
    ),
    "three components in 2D": Case(
        [r"displacements\[0\] \(lower_bottom\)\.value", "3 entries", "2D"],
        scene=swapped("[0.0, 0.0]", "[0.0, 0.0, 0.0]"),
    ),
    "missing group": Case(
        [r"scene\.toml", r"contacts\[0\] \(pair\)\.source", "'upper_botom'", "'upper_bottom'", "allowed"],
        scene=swapped('"upper_bottom"', '"upper_botom"'),
    ),
    "group of another kind": Case(
        [r"contacts\[0\] \(pair\)\.target", "'lower'", "cells", "allowed"],
        scene=swapped('"lower_top"', '"lower"'),
    ),
    "empty surface": Case(
        [r"contacts\[0\] \(pair\)\.target", "'lower_top'", "empty|no such group", "allowed"],
        mesh=mesh_text(elements=CELLS + [f for f in FACETS if f[1] != 4]),
    ),
    "NaN": Case(
        [r"mesh\.msh", "node 3", "not a finite number|not a gmsh mesh|cannot read"],
        mesh=mesh_text([*NODES[:2], ("nan", 1), *NODES[3:]]),
    ),
    "node without cell": Case(
        [r"mesh\.msh", "node 9", "no cell"],
        mesh=mesh_text([*NODES, (3, 3)], CELLS + FACETS + [(15, 8, (9,))], {**NAMES, (0, 8): "tip"}),
    ),
    "inverted cell": Case(
        [r"mesh\.msh", "cell", "quadrilateral"],
        mesh=mesh_text(elements=[(3, 1, (1, 2, 4, 3)), *CELLS[1:], *FACETS]),
    ),
    "cell in no body": Case(
        [r"mesh\.msh", "1 cells are in no body", "'upper'", "allowed"],
        scene=swapped('[[bodies]]\nregion = "upper"\nmaterial = "m"\n', ""),
    ),
    "cell in two bodies": Case(
        [r"mesh\.msh", "'upper'", "'lower'", "allowed: every cell in one body"],
        mesh=mesh_text(elements=[*CELLS, (3, 2, (1, 2, 3, 4), 1), *FACETS]),
    ),
    "surface inside a body": Case(
        [r"mesh\.msh", "'(upper_bottom|lower_top)'", "between two cells", "allowed"], mesh=INNER
    ),
    "conflicting supports": Case(
        [r"scene\.toml", r"displacements\[2\]", "lower_left", "component 0", "allowed"],
        scene=SCENE + '[[displacements]]\nregion = "lower_left"\nvalue = [0.1, "free"]\n',
    ),
    "not modelled": Case(
        [r"scene\.toml", "formulation", "penalty"],
        scene=swapped('name = "pair"', 'name = "pair"\nformulation = "penalty"'),
    ),
}
ALONE = ("no scene", "missing group", "NaN", "conflicting supports")
OPTIONS = {
    "theta": Case(
        ["command line", "-contact_theta", "3", "allowed"], words=("run", "SCENE", "-contact_theta", "3")
    ),
    "order": Case(
        ["command line", "-mesh_order", "'x'", "allowed"], words=("run", "SCENE", "-mesh_order", "x")
    ),
    "order of check": Case(
        ["-mesh_order", "'7'", "allowed: 1, 2"], words=("check", "SCENE", "-mesh_order", "7")
    ),
    "negative steps": Case(
        ["steps_count|steps.count", "-2", "allowed"], words=("run", "SCENE", "-steps_count", "-2")
    ),
    "ksp": Case(["ksp_type|KSP", "nonsense", "allowed"], words=("run", "SCENE", "-ksp_type", "nonsense")),
    "pc": Case(["pc_type|PC", "nonsense", "allowed"], words=("run", "SCENE", "-pc_type", "nonsense")),
    "command": Case(
        ["command line", "'rum'", "allowed: run, check, view", "nearest is 'run'"], words=("rum", "SCENE")
    ),
    "no operand": Case(["pcontact run", "no operand", "a scene file"], words=("run",)),
    "two operands": Case(["second operand", "allowed"], words=("run", "SCENE", "SCENE")),
    "view without results": Case(["nowhere", "no such directory"], words=("view", "nowhere")),
}

PROCESSES = {**{name: FILES[name] for name in ALONE}, **OPTIONS}


def environment():
    """That of a fresh shell: nothing of the MPI job that the tests may run in."""
    keep = {
        k: v for k, v in os.environ.items() if not k.startswith(("PMIX_", "PRTE_", "OMPI_COMM_", "OPAL_"))
    }
    keep["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [keep.get("PYTHONPATH")])])
    return {
        **keep,
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
        "OMP_NUM_THREADS": "1",
    }


def lay_out(folder, case):
    """The files of a case in a folder of its own; returns its command line."""
    folder.mkdir()
    if case.scene is not None:
        (folder / "scene.toml").write_text(case.scene)
    if case.mesh is not None:
        (folder / "mesh.msh").write_text(case.mesh)
    return ["scene.toml" if word == "SCENE" else word for word in case.words]


def launch(command, folder):
    """Run a command in a folder; one that hangs is an error."""
    return subprocess.run(
        command,
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        stdin=subprocess.DEVNULL,
    )


def execute(folder, words, ranks=None):
    """Run the program in a folder."""
    start = [] if ranks is None else ["mpirun", "-n", str(ranks)]
    return launch([*start, sys.executable, "-m", "pcontact", *words], folder)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """All cases, two at a time: most of their time is spent starting Python."""
    base = tmp_path_factory.mktemp("cases")

    def one(item):
        number, (name, case) = item
        folder = base / str(number)
        words = lay_out(folder, case)
        before = sorted(folder.rglob("*"))
        done = execute(folder, words)
        return name, (done, before == sorted(folder.rglob("*")))

    with ThreadPoolExecutor(2) as pool:
        return dict(pool.map(one, enumerate(PROCESSES.items())))


def check_line(text, parts):
    """Exactly one line, with everything in it."""
    lines = text.strip().splitlines()
    assert len(lines) == 1, text
    assert lines[0].startswith("pcontact: error: ")
    for part in parts:
        assert re.search(part, lines[0]), f"{part!r} is not in {lines[0]!r}"


@pytest.mark.parametrize("name", PROCESSES)
def test_bad_input(results, name):
    """Status 2, one line on stderr, no file written."""
    done, nothing_written = results[name]
    assert done.returncode == 2, done.stderr
    check_line(done.stderr, PROCESSES[name].parts)
    assert nothing_written
    assert "Traceback" not in done.stdout


IN_TURN = """\
import os, sys
from pcontact.cli import main
from pcontact.runtime.petsc import MPI
for folder in sys.argv[1].split(","):
    os.chdir(folder)
    MPI.COMM_WORLD.Barrier()
    status = "none"
    try:
        main(["run", "scene.toml"])
    except SystemExit as end:
        status = str(end.code)
    everyone = MPI.COMM_WORLD.gather(status)
    if MPI.COMM_WORLD.rank == 0:
        sys.stderr.write("status " + " ".join(everyone) + chr(10))
        sys.stderr.flush()
"""


@pytest.mark.parametrize("ranks", [1, 3])
def test_bad_files(tmp_path, ranks):
    """Every rank ends with status 2, one line comes out, nobody waits for the others, nothing is written."""
    folders = [tmp_path / str(k) for k in range(len(FILES))]
    for folder, case in zip(folders, FILES.values(), strict=True):
        lay_out(folder, case)
    before = sorted(tmp_path.rglob("*"))
    start = [] if ranks == 1 else ["mpirun", "-n", str(ranks)]
    done = launch([*start, sys.executable, "-c", IN_TURN, ",".join(map(str, folders))], tmp_path)
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 2 * len(FILES), done.stderr
    for (name, case), line, status in zip(FILES.items(), lines[::2], lines[1::2], strict=True):
        assert status == "status" + ranks * " 2", name
        check_line(line, case.parts)
    assert before == sorted(tmp_path.rglob("*"))


@pytest.mark.parametrize("case", [FILES["conflicting supports"], OPTIONS["ksp"]], ids=["supports", "ksp"])
def test_exit_status_on_three_ranks(tmp_path, case):
    folder = tmp_path / "case"
    words = lay_out(folder, case)
    done = execute(folder, words, ranks=3)
    assert done.returncode == 2
    ours = [line for line in done.stderr.splitlines() if line.startswith("pcontact: error: ")]
    assert len(ours) == 1
    check_line(ours[0], case.parts)
    assert "Traceback" not in done.stderr and "PETSC ERROR" not in done.stderr
    assert sorted(p.name for p in folder.iterdir()) == ["mesh.msh", "scene.toml"]


# -- runs that start well ----------------------------------------

# nothing moves in the first half of the run
LATE = Case([], scene=SCENE.replace("-0.05]", "-0.05]\namplitude = [[0, 0], [0.5, 0], [1, 1]]"))
# one iteration of a weak linear solver is not enough for anything that moves
WEAK = [
    "-snes_max_it",
    "1",
    "-ksp_max_it",
    "1",
    "-pc_type",
    "jacobi",
    "-steps_count",
    "4",
    "-steps_min",
    "0.1",
]


def report_of(folder):
    """report.json."""
    return json.loads((folder / "report.json").read_text())


@pytest.mark.parametrize("ranks", [None, 3])
def test_a_step_that_does_not_converge(tmp_path, ranks):
    """Status 1, one line that says why; the steps before it are kept in all files."""
    lay_out(tmp_path / "case", LATE)
    done = execute(tmp_path / "case", ["run", "scene.toml", "-o", "out", *WEAK], ranks)
    assert done.returncode == 1, done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("pcontact: error")]
    assert len(lines) == 1
    assert re.search(r"from time 0\.5 to 0\.625 did not converge \(.*residual", lines[0])
    assert ranks or len(done.stderr.splitlines()) == 1
    assert done.stdout.count("cut back") == 2
    report = report_of(tmp_path / "case" / "out")
    assert report["converged"] is False
    assert [step["time"] for step in report["steps"]] == [0.25, 0.5]
    rows = (tmp_path / "case" / "out" / "history.csv").read_text().splitlines()
    assert len(rows) == 3
    pvd = (tmp_path / "case" / "out" / "fields.pvd").read_text()
    assert set(re.findall(r'timestep="([^"]*)"', pvd)) == {"0.25", "0.5"}


def test_a_run_and_a_check(tmp_path):
    """Status 0 and what the user reads; an option that nothing asked for is named."""
    lay_out(tmp_path / "case", Case([]))
    done = execute(tmp_path / "case", ["check", "scene.toml"])
    assert done.returncode == 0 and done.stderr == ""
    for text in (
        "two squares",
        "body upper: 1 cells (quadrilateral), material m",
        "16 unknowns",
        "left out: friction",
    ):
        assert text in done.stdout
    assert not list((tmp_path / "case").glob("*results*"))
    done = execute(tmp_path / "case", ["run", "scene.toml", "-contact_tehta", "1"])
    assert done.returncode == 0, done.stderr
    assert report_of(tmp_path / "case" / "scene_results")["converged"] is True
    assert re.search("-contact_tehta was not used; the nearest is -contact_theta", done.stdout + done.stderr)
