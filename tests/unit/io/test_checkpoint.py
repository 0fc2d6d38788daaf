"""What a checkpoint is refused for: another mesh, other describe, damage; and what may change."""

import re
import shutil

import h5py
import numpy as np
import pytest

from pcontact.io.checkpoint import ANYWAY, NAME, Identity, read_checkpoint, remembering
from pcontact.mesh.hdf5 import convert
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import BLOCK, Damaged, append_checksums, verify
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.describe import differences, physics
from pcontact.scene.model import Contact, Obstacle
from pcontact.scene.reader import read_scene
from pcontact.scene.validate import resolve_contacts
from pcontact.simulation import Simulation
from tests.support.bad_input import CELLS, FACETS, NODES, SCENE, mesh_text
from tests.support.restarts import run

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel
CASE = (
    SCENE.replace('target = "lower_top"', 'target = "lower_top"\nfriction = 0.3')
    .replace("value = [0.0, -0.05]", "value = [0.02, -0.05]\namplitude = [[0, 0], [0.5, 1], [1, 0.5]]")
    .replace("[[bodies]]", "yield_stress = 15.0\nhardening = 50.0\n[[bodies]]", 1)
    + "[steps]\ncount = 4\n[output]\nfields = false\ncheckpoint = true\n[petsc]\nsnes_rtol = 1e-12\n"
)


def renumbered(order=(3, 0, 2, 1, 7, 5, 4, 6)):
    """The mesh of the two squares with its nodes in another order."""
    number = {old + 1: new + 1 for new, old in enumerate(order)}
    elements = [(kind, group, tuple(number[k] for k in nodes)) for kind, group, nodes in CELLS + FACETS]
    return mesh_text([NODES[k] for k in order], elements)


def lay(folder, scene=CASE, mesh=None):
    """A scene and its mesh in a new folder. *Collective.*"""

    def write():
        folder.mkdir()
        (folder / "mesh.msh").write_text(mesh or mesh_text())
        (folder / "scene.toml").write_text(scene)
        if "mesh.h5" in scene:
            convert(folder / "mesh.msh")

    on_root(WORLD, write)
    return read_scene(folder / "scene.toml")


@pytest.fixture
def half(shared_tmp):
    """Results of a run to half its time, which ends where its amplitude has a corner. *Collective.*"""
    scene = lay(shared_tmp / "half", CASE.replace("count = 4", "count = 2\nend = 0.5"))
    run(scene, WORLD, shared_tmp / "out")
    return shared_tmp / "out"


def go_on(scene, half, **options):
    """Records of a run that goes on, and its warnings. *Collective.*"""
    for name, value in options.items():
        PETSc.Options().setValue(name, value)
    try:
        return run(scene, WORLD, half.parent / "again", restart=half), log.warnings()
    finally:
        for name in options:
            PETSc.Options().delValue(name)


def refused(scene, half, **options):
    """The message, the same on all ranks. *Collective.*"""
    with pytest.raises(InputError) as caught:
        go_on(scene, half, **options)
    message = str(caught.value)
    assert "\n" not in message and "; allowed: " in message and set(WORLD.allgather(message)) == {message}
    return message


# -- other describe, other meshes -------------------------------

OTHER = {
    "materials.m.E: found 999.0; allowed: 1000.0, as in": ("E = 1000.0", "E = 999.0"),
    "materials.m.yield_stress: found 16.0; allowed: 15.0": ("yield_stress = 15.0", "yield_stress = 16.0"),
    "contacts[0] (pair).friction: found 0.2; allowed: 0.3": ("friction = 0.3", "friction = 0.2"),
    "contacts[0] (pair).friction: found nothing (the default); allowed: 0.3, as in": ("friction = 0.3", ""),
    "contacts[0] (pair).theta: found 1.0; allowed: 0.0": ("friction = 0.3", "friction = 0.3\ntheta = 1"),
    "mesh.kinematics: found plane_stress; allowed: nothing (the default)": (
        '"mesh.msh"', '"mesh.msh"\nkinematics = "plane_stress"'
    ),
    "displacements[1] (upper_top).value: found a list": ("[0.02, -0.05]", "[0.03, -0.05]"),
    "displacements[1] (upper_top).amplitude: found a factor of 0.9 at time 0.5": ("[0.5, 1]", "[0.5, 0.9]"),
    "displacements[1] (upper_top).amplitude: found a factor of 1 at time 0.5, or another": (
        "[[0, 0], [0.5, 1]", "[[0, 0], [0.25, 1], [0.5, 1]"
    ),
    "loads[0] (upper_top): found such a table; allowed: no such table": (
        "[steps]", '[[loads]]\nregion = "upper_top"\npressure = 1.0\n[steps]'
    ),
}  # fmt: skip


def test_other_physics(shared_tmp, half):
    for number, (said, change) in enumerate(OTHER.items()):
        message = refused(lay(shared_tmp / str(number), CASE.replace(*change)), half)
        assert said in message, message
        assert message.startswith(str(shared_tmp / str(number) / "scene.toml"))
        assert message.endswith(f"(or -{ANYWAY})")
    scene = lay(shared_tmp / "line")
    assert "(pair).theta: found -1.0; allowed: 0.0" in refused(scene, half, contact_theta="-1")


def test_what_may_change(shared_tmp, half):
    """Steps, solver, output, amplitudes to come, materials that no body has, the name and format of the mesh file."""
    run(lay(shared_tmp / "whole"), WORLD, shared_tmp / "full")
    changed = (
        CASE.replace("mesh.msh", "mesh.h5").replace("count = 4", "count = 3\nend = 0.75\nmin_step = 0.01")
        .replace("snes_rtol = 1e-12", 'pc_type = "lu"\npc_factor_mat_solver_type = "mumps"\nsnes_rtol = 1e-12')
        .replace("[1, 0.5]]", "[0.75, 0.75], [2, 5]]")
        .replace("[materials.m]", "[materials.n]\nE=1\nnu=0\n[materials.m]")
    )
    records, warnings = go_on(lay(shared_tmp / "changed", changed), half)
    assert not [line for line in warnings if "restart" in line] and records[-1]["time"] == 0.75
    # a ramp over a run that becomes longer would have been another one so far
    ramp = CASE.replace("amplitude = [[0, 0], [0.5, 1], [1, 0.5]]\n", "")
    run(lay(shared_tmp / "ramp", ramp.replace("count = 4", "count = 2\nend = 0.5")), WORLD, shared_tmp / "short")
    message = refused(lay(shared_tmp / "longer", ramp), shared_tmp / "short")
    assert re.search(r"amplitude: found .*0\.5 at time 0\.5.*; allowed: 1\b", message)


@parallel
def test_same_numbers_from_the_converted_mesh(shared_tmp, half):
    full = run(lay(shared_tmp / "whole"), WORLD, shared_tmp / "full")
    records, _ = go_on(lay(shared_tmp / "twin", CASE.replace("mesh.msh", "mesh.h5")), half)
    for a, b in zip(full[2:], records, strict=True):
        np.testing.assert_allclose(b["contacts"]["pair"]["force"], a["contacts"]["pair"]["force"], rtol=1e-9)


@parallel
def test_other_meshes(shared_tmp, half):
    """Stretched, renumbered, other groups, other cells; what a state cannot go on with stays refused."""
    stretched = [(x * (1.01 if y > 1.5 else 1.0), y) for x, y in NODES]
    facets = [f for f in FACETS if f[1] != 6]
    meshes = {
        "points": mesh_text(stretched),
        "cells": renumbered(),
        "groups.upper_top": mesh_text(elements=[*CELLS, *facets, (1, 6, (7, 8)), (1, 6, (6, 7))]),
    }
    for name, mesh in meshes.items():
        folder = shared_tmp / name
        message = refused(lay(folder, mesh=mesh), half)
        assert message.startswith(f"{folder / 'mesh.msh'}: {name}: found ") and "as in" in message
        assert (ANYWAY in message) == (name != "cells")
        if name == "cells":
            refused(lay(shared_tmp / "anyway", mesh=mesh), half, **{ANYWAY: "true"})
    records, warnings = go_on(lay(shared_tmp / "go", mesh=meshes["points"]), half, **{ANYWAY: "true"})
    assert len(records) == 2 and any("mesh.msh: points" in line for line in warnings)


@parallel
def test_the_user_insists(shared_tmp, half):
    """A warning for each difference; other points of contact are another memory, and refused."""
    changed = CASE.replace("E = 1000.0", "E = 900.0").replace("friction = 0.3", "friction = 0.2")
    scene = lay(shared_tmp / "other", changed)
    records, warnings = go_on(scene, half, **{ANYWAY: "true"})
    assert len(records) == 2
    for said in ("materials.m.E: 900.0 instead of 1000.0", "(pair).friction: 0.2 instead of 0.3"):
        assert any(said in line for line in warnings)
    scene = lay(shared_tmp / "points", CASE.replace("friction = 0.3", "friction = 0.3\nquadrature = 9"))
    assert re.search(r"points or cells of pair: found \d+ of digest", refused(scene, half, **{ANYWAY: "true"}))


def test_functions_by_their_text(tmp_path):
    """The text of a level set belongs to the physics; a file that another line names, too."""
    scene = lay(tmp_path / "case")
    (tmp_path / "case" / "phi.py").write_text("def phi(x, t):\n    return x[:, 1]\n")
    obstacle = Obstacle("level_set", function="phi.py:phi")
    scene.contacts = [Contact("upper_bottom", obstacle=obstacle, name="floor")]
    before = physics(scene)
    assert not differences(before, physics(scene), 1.0)
    (tmp_path / "case" / "phi.py").write_text("def phi(x, t):\n    return x[:, 1] + 0.01\n")
    (found,) = differences(before, physics(scene), 1.0)
    assert found[0] == "contacts[0] (floor).obstacle.function" and "phi.py:phi, text" in found[1]


def test_keys_that_are_new(tmp_path):
    """A checkpoint of a version of the program that did not know a key goes on where the key has its default."""
    scene = resolve_contacts(lay(tmp_path / "case"), {})
    then, now = physics(scene), physics(scene)
    assert then["contacts[0] (pair)"].pop("theta") == 0.0 and "hardening_curve" not in now["materials.m"]
    assert not differences(then, now, 1.0)
    now["contacts[0] (pair)"]["theta"] = 1.0
    assert differences(then, now, 1.0) == [("contacts[0] (pair).theta", "1.0", "0.0")]


# -- damage -------------------------------


def spoil(path, change):
    """Change a file with HDF5, and give it the checksums of what it holds then."""
    with h5py.File(path, "r+") as file:
        change(file)
    append_checksums(path)


def set_head(key, value):
    return lambda file: file.attrs.modify(key, value)


def first_table(file, item):
    """The first table of an item that is not empty."""
    return next(t for t in file["memory"].values() if t.attrs["item"] == item and len(t["key"]))


def cut(name):
    """One row less, in keys and values."""

    def change(file):
        for part in ("key", "value"):
            data = file[f"{name}/{part}"][:-1]
            del file[f"{name}/{part}"]
            file[f"{name}/{part}"] = data

    return change


def twice(table):
    table["key"][-1] = table["key"][0]


SPOILT = {
    "time: found -0.5; allowed: a time > 0": set_head("time", -0.5),
    "time: found nan": set_head("time", np.nan),
    "size: found -1; allowed: a load step > 0": set_head("size", -1.0),
    "number: found -2; allowed: a number of load steps >= 1": set_head("number", -2),
    "begin: found 0.7; allowed: a time >= 0, below 0.5": set_head("begin", 0.7),
    "first: found 0.9; allowed": set_head("first", 0.9),
    "version: found 3; allowed: 4, as in this run": set_head("version", 3),
    "displacement: found 8 rows, and none for 1 nodes": lambda file: twice(file["displacement"]),
    "displacement: found 7 rows": cut("displacement"),
    "before: found 7 rows": cut("before"),
    "values that are no numbers": lambda file: file["displacement/value"].__setitem__(2, np.nan),
    "values that are no numbers)": lambda file: first_table(file, "pair")["value"].__setitem__(0, np.inf),
    "status of pair: found": lambda file: twice(first_table(file, "pair")),
    "of points of this run": lambda file: first_table(file, "pair")["key"].__setitem__(0, 77),
    "of bodies that may yield: found": lambda file: first_table(file, "bodies that may yield")["key"].__setitem__(0, 9),
    "no readable checkpoint": lambda file: file.__delitem__("before"),
    "no readable checkpoint (": lambda file: file.__delitem__("identity"),
    "no readable": lambda file: file.attrs.__delitem__("time"),
}


def altered(folder, half, change):
    """A copy of the results whose checkpoint has been changed. *Collective.*"""

    def work():
        folder.mkdir(exist_ok=True)
        shutil.copy(half / NAME, folder / NAME)
        change(folder / NAME)

    on_root(WORLD, work)
    return folder


@pytest.fixture
def resume(shared_tmp, half):
    """Reads all of a checkpoint for a run that goes on; returns the message, the same on all ranks. *Collective.*"""
    simulation = Simulation(lay(shared_tmp / "case"))
    space, items = simulation.problem.space, simulation.remembering
    identity = Identity.of([simulation.scene], space, remembering(items))

    def read(folder):
        try:
            read_checkpoint(folder, space, identity).recall(WORLD, items)
        except InputError as error:
            message = str(error)
            assert "\n" not in message and "; allowed: " in message and set(WORLD.allgather(message)) == {message}
            return message
        return ""

    assert read(half) == ""
    yield read
    simulation.close()


@parallel
def test_what_cannot_be(shared_tmp, half, resume):
    """Numbers that no run has written, though the checksums are right."""
    for said, change in SPOILT.items():
        folder = altered(shared_tmp / "spoilt", half, lambda path, change=change: spoil(path, change))
        message = resume(folder)
        assert said in message and message.startswith(f"{folder / NAME}: "), (said, message)


@parallel
def test_flipped_bits(shared_tmp, half, resume):
    """Wherever they are: in numbers, in HDF5's tables, in the checksums; and bytes that lack or are too many."""
    data = (half / NAME).read_bytes()
    places = [*np.random.default_rng(5).integers(0, len(data), 60), *range(len(data) - 60, len(data))]
    for place in places:

        def flip(path, place=place):
            changed = bytearray(data)
            changed[place] ^= 1 << (place % 8)
            path.write_bytes(changed)

        message = resume(altered(shared_tmp / "flip", half, flip))
        assert re.search("damaged|no checksums", message), (place, message)
    for other in (data[:-7], data[: len(data) // 2], data + b"x", b""):
        message = resume(altered(shared_tmp / "cut", half, lambda path, other=other: path.write_bytes(other)))
        assert re.search("no checksums|no readable", message), message


def test_checksums(tmp_path):
    """Each rank its share: together they see every byte."""
    path, random = tmp_path / "file", np.random.default_rng(1)
    for size in (0, 1, BLOCK - 1, BLOCK, 2 * BLOCK + 5):
        data = random.bytes(size)
        path.write_bytes(data)
        assert not verify(path)
        append_checksums(path)
        assert all(verify(path, rank, ranks) for ranks in (1, 2, 5) for rank in range(ranks))
        assert path.read_bytes().startswith(data)
        for place in {0, size // 2, size - 1} & set(range(size)):
            changed = bytearray(path.read_bytes())
            changed[place] ^= 16
            (tmp_path / "changed").write_bytes(changed)
            for ranks in (1, 3):
                found = []
                for rank in range(ranks):
                    try:
                        verify(tmp_path / "changed", rank, ranks)
                    except Damaged:
                        found.append(rank)
                assert len(found) == 1


@parallel
def test_results_that_cannot_be_read(shared_tmp, half):
    """A run that goes on where it was keeps its rows; what it cannot make out it refuses, before any load step."""
    scene = lay(shared_tmp / "case")
    scene.output.fields = True
    texts = {"report.json": "[1, 2]", "steps.jsonl": "[1, 2]\n"}
    for name, text in {**texts, "history.csv": "time,a\nx,1\n", "fields.pvd": "<VTKFile"}.items():
        def damage(name=name, text=text):
            shutil.copytree(half, shared_tmp / name)
            if name == "report.json":
                # its load steps are those of steps.jsonl, where there is one
                (shared_tmp / name / "steps.jsonl").unlink()
            (shared_tmp / name / name).write_text(text)

        on_root(WORLD, damage)
        with pytest.raises(InputError, match=f"{name}: found what cannot be read") as caught:
            run(scene, WORLD, shared_tmp / name, restart=shared_tmp / name)
        assert set(WORLD.allgather(str(caught.value))) == {str(caught.value)}
