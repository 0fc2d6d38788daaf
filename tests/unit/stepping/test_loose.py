"""Bodies that no support holds and no contact force any more: where they stay, and that the run says so."""

import csv
import json
import shutil

import gmsh
import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases.stack import scene as heap_scene
from meshes import heap, one_block, two_blocks
from meshes.tools import gmsh_model
from pcontact.io.report import flatten
from pcontact.runtime import log
from pcontact.runtime.observer import Observer
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene, Steps
from pcontact.simulation import Simulation
from pcontact.space.modes import RigidBodies
from pcontact.stepping.loose import Announcer
from tests.support.small import blocks_file

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
# of the block, by which positions may differ
SAME = 1e-6


def lid_scene(path, dim, bodies=("block",), surfaces=("bottom", "top"), height=1.0, friction=0.3, petsc=None, up=0.02,
              **more):  # fmt: skip
    """Blocks between a floor and a lid that presses and drags them, and goes up again to where it was, and beyond."""
    axis = dim - 1

    def along(value, sideways=0.0):
        return [sideways, *[0.0] * (dim - 2), value]

    moves = {"displacement": along(-0.02, 0.004), "amplitude": [(0, 0), (0.5, 1), (1, -up / 0.02)]}
    floor = Obstacle("plane", point=along(0.0), normal=[float(k == axis) for k in range(dim)])
    lid = Obstacle("plane", point=along(height), normal=[-float(k == axis) for k in range(dim)], **moves)
    contacts = [
        Contact(surfaces[0], obstacle=floor, name="floor", friction=friction),
        Contact(surfaces[1], obstacle=lid, name="lid", friction=friction),
    ]
    return Scene(
        mesh=MeshSpec(path), materials={"m": Material(1000.0, 0.3)}, bodies=[Body(b, "m") for b in bodies],
        contacts=contacts + more.pop("contacts", []), steps=Steps(1.0, 4, 0.1),
        output=Output(fields=False, probes=list(bodies)), petsc=petsc or {}, **more,
    )  # fmt: skip


class Rows(Observer):
    """Observer: the records of a run."""

    def __init__(self):
        self.records = []

    def step(self, step, u, record):
        self.records.append(record)


def solved(scene, comm=WORLD, directory=None):
    """Records of a run that has converged. Collective on `comm`."""
    rows, simulation = Rows(), Simulation(scene, comm)
    try:
        assert simulation.run(directory, [rows])
    finally:
        simulation.close()
    return rows.records


def places(records):
    """Mean, smallest and largest displacement of all probes at all steps."""
    return np.array([[list(probe.values()) for probe in record["probes"].values()] for record in records])


def renumbered(source, path):
    """The same mesh with its nodes in another order."""
    with gmsh_model("renumbered"):
        gmsh.open(str(source))
        tags = gmsh.model.mesh.getNodes()[0]
        gmsh.model.mesh.renumberNodes(tags, np.random.default_rng(1).permutation(tags))
        gmsh.write(str(path))


@pytest.mark.parallel
@pytest.mark.parametrize("dim", [2, 3])
def test_a_free_block_stays_where_it_was(shared_tmp, dim):
    """On any ranks, with any linear solver, with nodes in any order."""
    path, other = shared_tmp / "b.msh", shared_tmp / "c.msh"
    on_root(WORLD, one_block, path, dim, 5 if dim == 2 else 2)
    on_root(WORLD, renumbered, path, other)
    records = solved(lid_scene(path, dim))
    assert [record["free"] for record in records] == [[], [], ["block"], ["block"]]
    assert [record["free_bodies"] for record in records] == [0, 0, 1, 1]
    mean = places(records)[:, 0, 0]
    # not moved as a whole where nothing overlaps, pushed out of the floor where it does
    np.testing.assert_allclose(mean[2:, 0], mean[1, 0], atol=1e-9)
    assert mean[1, 0] == pytest.approx(0.002, rel=0.1) and abs(mean[1, -1] + 0.01) < 1e-3
    np.testing.assert_allclose(mean[2:, -1], 0.0, atol=1e-9)
    for comm, file, petsc in [(SELF, path, {}), (SELF, path, {"pc_type": "lu"}), (WORLD, other, {})]:
        np.testing.assert_allclose(places(solved(lid_scene(file, dim, petsc=petsc), comm)), places(records), atol=SAME)


@pytest.mark.parallel
def test_free_blocks_push_each_other_out_of_the_floor(shared_tmp):
    """Two loose blocks, one on the other: free both, none overlaps, the same on any ranks and with any solver."""
    path = shared_tmp / "b.msh"
    on_root(WORLD, blocks_file, path, "quadrilateral", 4, 5)
    pair = Contact("upper_bottom", "lower_top", friction=0.3, name="pair")
    sizes = {"bodies": ("lower", "upper"), "surfaces": ("lower_bottom", "upper_top"), "height": 2.0}

    def scene(**petsc):
        return lid_scene(path, 2, contacts=[pair], petsc=petsc, **sizes)

    records = solved(scene())
    assert records[-1]["free"] == ["lower", "upper"] and records[0]["free"] == []
    for name in ("floor", "pair", "lid"):
        assert records[-1]["contacts"][name]["max_penetration"] < 1e-11
    found = places(records)
    # stress-free and flat on the floor, without a turn; nothing holds the upper one down, either
    np.testing.assert_allclose(found[-1, :, 0, 1], 0.0, atol=1e-9)
    np.testing.assert_allclose(found[-1, :, 2] - found[-1, :, 1], 0.0, atol=1e-9)
    for petsc, comm in (({}, SELF), ({"pc_type": "lu"}, WORLD)):
        other = places(solved(scene(**petsc), comm))
        np.testing.assert_allclose(other[:2], found[:2], atol=SAME)
        # nothing says where free blocks lie: what they slip on the way there is small beside the motion
        np.testing.assert_allclose(other[2:], found[2:], atol=1e-4)
        np.testing.assert_allclose(other[-1, :, 0, 1], 0.0, atol=1e-9)


def adhesion_scene(path, contacts, petsc, E=1.0, squeeze=0.0):
    """A soft block that may move up and down, with adhesion; far above it a block that bears forces of its own."""
    return Scene(
        mesh=MeshSpec(path),
        materials={"soft": Material(1.0, 0.2), "hard": Material(E, 0.2)},
        bodies=[Body("lower", "soft"), Body("upper", "hard")],
        contacts=contacts,
        displacements=[
            Displacement("upper_bottom", [0.0, 0.0]),
            Displacement("upper_top", [0.0, -squeeze], amplitude=[(0, 0), (1, 1)]),
            Displacement("lower_left", [0.0, "free"]),
        ],
        steps=Steps(1.0, 2), output=Output(fields=False, probes=["lower"]), petsc=petsc,
    )  # fmt: skip


@pytest.mark.parallel
def test_a_body_comes_to_rest_by_its_own_forces(shared_tmp):
    """A round floor with adhesion lifts a soft block beside a stiff one that is squeezed: what its residual may be is a
    million times what adhesion can bear. The slope of the floor has the block slip out of the reach of adhesion."""
    path = shared_tmp / "b.msh"
    on_root(WORLD, lambda: two_blocks(path, 2, 3, 3, gap=0.5))
    lifts = {"displacement": [0.0, 0.2], "amplitude": [(0, 0), (1, 1)]}
    round_floor = Obstacle("sphere", center=[0.0, -100.0], radius=100.0, **lifts)
    floor = Contact("lower_bottom", obstacle=round_floor, name="floor", friction=0.4, adhesion=0.003)

    def run(comm=WORLD, **petsc):
        return solved(adhesion_scene(path, [floor], petsc, 1e6, 0.1), comm)

    records = run()
    # a free one stays where nothing acts on it, not where it does not overlap
    for record in records:
        assert record["free"] == ["lower"] and record["contacts"]["floor"]["force"] == [0.0, 0.0]
    found = places(records)
    assert (found[:, 0, 0, 1] > np.array([0.1, 0.2])).all()
    np.testing.assert_allclose(found[:, 0, 1], found[:, 0, 0], atol=1e-9)
    for comm, petsc in [(SELF, {}), (WORLD, {"pc_type": "lu", "snes_rtol": 1e-12})]:
        np.testing.assert_allclose(places(run(comm, **petsc)), found, atol=1e-9)


@pytest.mark.parallel
def test_what_rounding_errors_move_is_not_brought_to_where_it_touches(shared_tmp):
    """A sloping lid with adhesion drags a block and loses it: what is left is its strain, in a step of its size."""
    path = shared_tmp / "b.msh"
    on_root(WORLD, lambda: two_blocks(path, 2, 3, 3, gap=0.5))
    flat = Obstacle("plane", point=[0.0, -0.005], normal=[0.0, 1.0])
    slope = Obstacle("plane", point=[0.0, 1.0], normal=[0.005, -1.0], displacement=[0.01, 0.0])
    contacts = [
        Contact("lower_bottom", obstacle=flat, name="floor"),
        Contact("lower_top", obstacle=slope, name="lid", friction=0.07, adhesion=1e-4),
    ]
    for petsc in ({}, {"pc_type": "lu", "snes_rtol": 1e-12}):
        records = solved(adhesion_scene(path, contacts, petsc))
        assert [record["time"] for record in records] == [0.5, 1.0]
        assert all(record["cutbacks"] == 0 and record["free"] == ["lower"] for record in records)
        assert records[-1]["contacts"]["lid"]["force"] == [0.0, 0.0]


@pytest.mark.parallel
def test_a_load_on_a_body_that_nothing_holds_fails(shared_tmp):
    """A force sideways: as long as the lid presses, friction bears it."""
    path = shared_tmp / "b.msh"
    on_root(WORLD, one_block, path, 2, 2)
    load = Load("block", body_force=[1.0, 0.0])
    rows, simulation = Rows(), Simulation(lid_scene(path, 2, loads=[load]))
    try:
        assert not simulation.run(None, [rows])
    finally:
        simulation.close()
    assert rows.records[-1]["time"] >= 0.5 and all(record["free"] == [] for record in rows.records)


@pytest.mark.parallel
def test_a_loose_body_where_there_is_no_contact(shared_tmp):
    path = shared_tmp / "b.msh"
    on_root(WORLD, two_blocks, path, 2, 2, 2)
    case = Scene(
        mesh=MeshSpec(path, strain="finite"),
        materials={"m": Material(1000.0, 0.3)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        displacements=[Displacement("lower_bottom", [0.0, 0.0])],
        loads=[Load("lower_top", traction=[0.0, 1.0])],
        output=Output(fields=False, probes=["lower", "upper"]),
        steps=Steps(1.0, 2),
    )
    records = solved(case)
    assert [record["free"] for record in records] == [["upper"]] * 2
    assert places(records)[-1, 0, :, 1].max() > 1e-4
    np.testing.assert_array_equal(places(records)[:, 1], 0.0)


@pytest.mark.parallel
def test_a_heap_with_room(shared_tmp):
    """Disks that the plate moves about, none of which is caught: they make room without any force, the same on any
    ranks and with any solver, and no iteration is needed to find that out."""
    path = make_mesh(heap, shared_tmp / "h.msh", 2, 5, 0.5, 0.0, None, 1, 0.0)

    def rows(comm, **petsc):
        case = heap_scene(path, 2, 5, friction=0.5, press=0.013, steps=3, overlap=0.0, petsc=petsc)
        case.output.probes = ["heap"]
        return solved(case, comm)

    records = rows(WORLD)
    assert [len(record["free"]) for record in records] == [5] * 3 and records[-1]["free"][4] == "heap 4"
    assert [record["newton"] for record in records[1:]] == [0, 0]
    # the plate has moved them
    assert places(records)[-1, 0, 1, 1] < -0.002
    for comm, petsc in [(SELF, {}), (WORLD, {"pc_type": "lu"})]:
        np.testing.assert_allclose(places(rows(comm, **petsc)), places(records), atol=SAME)


@pytest.mark.parallel
def test_a_pressed_heap_in_space(shared_tmp):
    """Balls that friction holds: places and forces are determined, far below the tolerance of the residual."""
    path = make_mesh(heap, shared_tmp / "h.msh", 3, 5, 0.6, 0.0, None, 1, 0.06)
    found = []
    for comm, petsc in [(WORLD, {}), (SELF, {"pc_type": "lu", "snes_rtol": "1e-11"})]:
        case = heap_scene(path, 3, 5, friction=0.3, press=0.05, steps=1, overlap=0.06, petsc=petsc)
        case.output.probes = ["heap"]
        records = solved(case, comm)
        assert records[0]["free"] == [] and records[0]["contacts"]["floor"]["force"][2] < -1.0
        found.append((places(records), [body["force"] for body in records[0]["contacts"]["all"]["bodies"]]))
    np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-8)
    np.testing.assert_allclose(found[0][1], found[1][1], atol=1e-6 * np.abs(found[0][1]).max())


@pytest.mark.parallel
def test_report_history_and_warning(shared_tmp):
    path = shared_tmp / "b.msh"
    on_root(WORLD, one_block, path, 2, 2)
    solved(lid_scene(path, 2), directory=shared_tmp / "run")
    if WORLD.rank == 0:
        report = json.loads((shared_tmp / "run" / "report.json").read_text())
        assert [step["free"] for step in report["steps"]] == [[], [], ["block"], ["block"]]
        words = [text for text in report["warnings"] if "free" in text]
        assert len(words) == 1 and "block" in words[0] and words[0].startswith("time 0.75:")
        with open(shared_tmp / "run" / "history.csv", newline="") as stream:
            assert [row["free_bodies"] for row in csv.DictReader(stream)] == ["0", "0", "1", "1"]


class Copies(Rows):
    """Keeps the checkpoint of the third load step, as a run that died after it would leave it."""

    def __init__(self, directory):
        super().__init__()
        self.directory = directory

    def step(self, step, u, record):
        super().step(step, u, record)
        if step.number == 3:
            shutil.copytree(self.directory, f"{self.directory}_3")


def test_a_restarted_run_leaves_free_bodies_alike(tmp_path):
    """Disks that have room: those that were free before make it in the first load step after the restart."""
    path = make_mesh(heap, tmp_path / "h.msh", 2, 5, 0.5, 0.0, None, 1, 0.0)

    def scene():
        case = heap_scene(path, 2, 5, friction=0.5, press=0.017, steps=4, overlap=0.0)
        case.output.probes, case.output.checkpoint = ["heap"], True
        return case

    whole, directory = Copies(tmp_path / "run"), tmp_path / "run"
    for watch, restart, place in [(whole, None, directory), (Rows(), f"{directory}_3", tmp_path / "again")]:
        if restart is not None:
            PETSc.Options().setValue("restart", restart)
        simulation = Simulation(scene(), SELF)
        try:
            assert simulation.run(place, [watch])
        finally:
            simulation.close()
            PETSc.Options().delValue("restart")
    assert [len(record["free"]) for record in whole.records] == [5] * 4 and len(watch.records) == 1
    assert watch.records[0]["free"] == whole.records[3]["free"]
    np.testing.assert_allclose(places(watch.records), places(whole.records[3:]), atol=1e-13)


def test_bodies_of_one_name_are_told_apart():
    names = Announcer(["plate", "heap", "heap", "floor"])
    assert names(0.5, [0, 2]) == ["plate", "heap 2"] and names(1.0, []) == []


def test_a_body_is_warned_of_once():
    """One that loses contact again and again is in the log alone."""
    log.forget_warnings()
    names = Announcer(["block"])
    for time, free in enumerate([[0], [0], [], [0], []]):
        names(float(time), free)
    assert len(log.warnings()) == 1 and log.warnings()[0].startswith("time 0:")
    log.forget_warnings()


def test_what_nothing_ever_held_is_told_apart():
    """Whoever goes on from a checkpoint cannot know."""
    for first, said in ((True, "no contact force ever has"), (False, "no contact force holds")):
        log.forget_warnings()
        names = Announcer(["block", "lid"])
        names(0.5, [0], first)
        names(1.0, [0, 1])
        own, other = log.warnings()
        assert said in own and "body block" in own and "no support and no contact force holds body lid: free" in other
    log.forget_warnings()


@pytest.mark.parametrize(
    ("traction", "said"),
    [([0.0, 100.0], "no support holds upper, which no contact held before this load step: a support is missing"),
     ([10.0, -1.0], "contact alone holds upper, and may not be able to: a support is missing")],
)  # fmt: skip
def test_a_missing_support_is_named(tmp_path, traction, said):
    """Of a block that is drawn off another one, or along it with more than friction bears."""
    path = blocks_file(tmp_path / "b.msh", "quadrilateral", 2, 2)
    scene = Scene(
        mesh=MeshSpec(path), materials={"m": Material(1000.0, 0.3)}, bodies=[Body(b, "m") for b in ("lower", "upper")],
        contacts=[Contact("upper_bottom", "lower_top", friction=0.3)],
        displacements=[Displacement("lower_bottom", [0.0, 0.0])], loads=[Load("upper_top", traction=traction)],
        steps=Steps(min_step=1.0), output=Output(fields=False), petsc={"snes_max_it": "20"},
    )  # fmt: skip
    simulation = Simulation(scene, SELF)
    assert not simulation.run()
    assert said in str(simulation.failure)
    simulation.close()


def test_names_are_no_columns():
    assert flatten({"free": ["block"], "free_bodies": 1}) == {"free_bodies": 1}


def test_motions_change_distances_as_foreseen(tmp_path):
    """The rows of a pair of bodies, and of an obstacle, against distances after a motion of both bodies."""
    path = blocks_file(tmp_path / "b.msh", "hexahedron", 2, 2)
    pair = Contact("upper_bottom", "lower_top", name="pair")
    sizes = {"bodies": ("lower", "upper"), "surfaces": ("lower_bottom", "upper_top"), "height": 2.0}
    simulation = Simulation(lid_scene(path, 3, contacts=[pair], friction=0.0, **sizes), SELF)
    try:
        problem, space = simulation.problem, simulation.problem.space
        u = space.vector()
        for item in problem.items:
            item.detect(u, 0.25)
        bodies = RigidBodies(space, problem.stabilisation, simulation.rest.motions)
        amounts = 0.01 * np.random.default_rng(3).standard_normal((2, 6))
        fields = [space.vector() for _ in bodies.fields]
        for field, values in zip(fields, bodies.fields, strict=True):
            field.setArray(values.ravel())
        moved = space.vector()
        moved.setArray(bodies.field(amounts).ravel())
        np.testing.assert_allclose(bodies.amounts(bodies.field(amounts)), amounts, atol=1e-14)
        for _, active in problem.active.sets:
            before, numbers, rows = active.clearance(u, fields)
            after = active.clearance(moved, fields)[0]
            known = sum((rows[:, k] * amounts[numbers[:, k]]).sum(axis=1) * (numbers[:, k] >= 0) for k in (0, 1))
            assert len(before) and np.abs(known).max() > 1e-3
            np.testing.assert_allclose(after, before + known, atol=1e-13)
    finally:
        simulation.close()


@pytest.mark.parametrize("law, hangs", [({}, False), ({"friction": 0.3}, False), ({"tresca": 0.1}, True)])
def test_how_far_a_loose_body_goes_before_it_touches(tmp_path, law, hangs):
    """To where it touches, unless open points bear a traction along which it may hang: then its step has a size."""
    gap = 0.02
    two_blocks(tmp_path / "b.msh", 2, 2, 2, gap=gap)
    case = Scene(
        mesh=MeshSpec(tmp_path / "b.msh"),
        materials={"m": Material(1000.0, 0.3)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", name="pair", **law)],
        displacements=[Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_left", [0.0, "free"])],
        output=Output(fields=False),
    )
    simulation = Simulation(case, SELF)
    try:
        space = simulation.problem.space
        (pair,) = simulation.problem.contacts[0].pairs
        u, y = space.vector(), space.vector()
        pair.detect(u, 0.0)
        way = y.getArray().reshape(-1, 2)
        upper = space.points[space.owned_local, 1] > 1.0 + 0.5 * gap
        # a long step ends a tenth of a facet deep
        for length, fall in ((1e-6, 0.99e6 * gap), (0.1, (gap + 0.05) / 0.1)):
            part = min(fall, 1.0) if hangs else fall
            way[upper, 1] = length
            assert pair.active.step_limit(u, y) == pytest.approx(part, rel=1e-6)
            # where it falls it does not hang, and where nothing falls a step has its size
            assert pair.active.step_limit(u, y, np.array([False, True])) == pytest.approx(fall, rel=1e-6)
            assert pair.active.step_limit(u, y, np.array([False, False])) == pytest.approx(min(fall, 1.0), rel=1e-6)
        # a pair that it falls away from has no say
        y.scale(-1.0)
        assert pair.active.step_limit(u, y, np.array([False, True])) is None
    finally:
        simulation.close()
