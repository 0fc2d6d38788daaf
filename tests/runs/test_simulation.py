"""Whole runs: report, balance of forces, load steps; and the stepping alone, with a made-up problem."""

import csv
import json

import numpy as np
import pytest

from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.model import Contact, Displacement, Load, Material, Obstacle, Output, Steps
from pcontact.simulation import Simulation
from tests.support.blocks import scene_of
from tests.support.records import Log
from tests.support.small import DIMENSION, blocks_file

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel


@pytest.fixture
def mesh_file(shared_tmp):
    """Makes the mesh of a cell, on rank 0."""

    def make(cell, n_lower=2, n_upper=2, **more):
        path = shared_tmp / "blocks.msh"
        if WORLD.rank == 0:
            blocks_file(path, cell, n_lower, n_upper, **more)
        WORLD.Barrier()
        return path

    return make


@pytest.fixture
def run():
    """Runs scenes and takes their solver options out again."""
    made = []

    def start(scene, directory=None, observers=()):
        simulation = Simulation(scene)
        made.append(simulation)
        return simulation, simulation.run(directory, observers)

    yield start
    for simulation in made:
        simulation.close()


# -- report and history ----------------------------------------


@parallel
def test_report_and_history(mesh_file, run, shared_tmp):
    """Everything that SCENE promises, with the right type, and the same numbers in both files."""
    path = mesh_file("quadrilateral", 2, 3)
    simulation, converged = run(scene_of(path, "quadrilateral", steps=Steps(1.0, 2)), shared_tmp / "out")
    WORLD.Barrier()
    assert converged
    n_points = WORLD.allreduce(len(simulation.problem.items[1].source.facet))
    report = json.loads((shared_tmp / "out" / "report.json").read_text())
    assert report["title"] == "two blocks" and report["converged"] is True
    assert report["ranks"] == WORLD.size and report["cells"] == 13
    assert report["dofs"] == 2 * (9 + 16) == simulation.problem.space.n_dofs
    assert any("lower" in text and "upper" in text for text in report["model"]["active"])
    assert {"friction", "plasticity"} <= set(report["model"]["left_out"])
    assert {"setup", "search", "solve", "total", "compile", "peak_memory_mb"} <= set(report["timing"])
    assert report["timing"]["total"] >= report["timing"]["solve"] > 0
    assert [s["time"] for s in report["steps"]] == [0.5, 1.0]
    for step in report["steps"]:
        assert step["newton"] >= 1 and step["krylov"] >= 1 and step["cutbacks"] == 0
        assert set(step["reactions"]) == {"lower_bottom", "upper_top", "left"}
        pair = step["contacts"]["pair"]
        assert set(pair) == {
                "force", "area", "max_pressure", "max_penetration", "deepest", "least_gap", "open", "stick", "slip",
                "flipped", "passed", "left", "target_penetration", "facets", "normal_force", "friction_force",
                "centre", "moment", "unresolved",
            }  # fmt: skip
        assert pair["open"] + pair["slip"] == n_points and pair["stick"] == 0
        assert pair["area"] == pytest.approx(1.0)
        assert pair["force"][1] < 0 < pair["max_pressure"]
        assert set(step["probes"]) == {"upper_top", "lower_top", "upper_origin"}
        np.testing.assert_allclose(
            step["probes"]["upper_top"]["mean"], [0.0, -0.02 * step["time"]], atol=1e-15
        )
        for probe in step["probes"].values():
            assert np.all(np.array(probe["min"]) <= np.array(probe["mean"]) + 1e-15)
            assert np.all(np.array(probe["mean"]) <= np.array(probe["max"]) + 1e-15)
        # a group of one point
        assert step["probes"]["upper_origin"]["min"] == step["probes"]["upper_origin"]["max"]
        assert step["plastic"] == {"max_equivalent_strain": 0.0, "yielded_volume": 0.0}
    with open(shared_tmp / "out" / "history.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 2
    for row, step in zip(rows, report["steps"], strict=True):
        assert float(row["time"]) == step["time"]
        assert float(row["contacts.pair.force_y"]) == step["contacts"]["pair"]["force"][1]
        assert float(row["reactions.upper_top_y"]) == step["reactions"]["upper_top"][1]
        assert float(row["probes.lower_top.mean_y"]) == step["probes"]["lower_top"]["mean"][1]


@parallel
def test_nothing_is_written_without_a_directory(mesh_file, run, shared_tmp):
    path = mesh_file("quadrilateral")
    before = sorted(shared_tmp.rglob("*"))
    _, converged = run(scene_of(path, "quadrilateral"))
    assert converged and sorted(shared_tmp.rglob("*")) == before


# -- balance ----------------------------------------


@parallel
@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_reactions_balance_contact_and_loads(mesh_file, run, cell, theta):
    """Each body is in balance: supports, loads, and the contact force, `force` on the target."""
    d = DIMENSION[cell]
    path = mesh_file(cell, 2, 3 if d == 2 else 2, gap=0.01)
    free = ["free"] * (d - 1)
    side, weight = 0.3, 0.2
    scene = scene_of(
        path,
        cell,
        theta,
        displacements=[
            Displacement("lower_bottom", [0.0] * d),
            Displacement("upper_top", [*free, -0.04]),
            Displacement("upper_left", [0.0, *["free"] * (d - 1)]),
            *([Displacement("upper_front", ["free", 0.0, "free"])] if d == 3 else []),
        ],
        loads=[Load("lower_right", pressure=side), Load("upper", body_force=[0.0] * (d - 1) + [-weight])],
    )
    watch = Log()
    simulation, converged = run(scene, None, [watch])
    assert converged and watch.verdict is True
    record = watch.records[-1]
    force = np.array(record["contacts"]["pair"]["force"])
    assert force[-1] < -0.05
    reactions = {name: np.array(value) for name, value in record["reactions"].items()}
    pull = np.zeros(d)
    pull[0] = -side
    np.testing.assert_allclose(reactions["lower_bottom"] + force + pull, 0.0, atol=1e-9)
    own_weight = np.zeros(d)
    own_weight[-1] = -weight
    upper = sum(value for name, value in reactions.items() if name.startswith("upper"))
    np.testing.assert_allclose(upper - force + own_weight, 0.0, atol=1e-9)
    # frictionless on a surface that was flat: its facets have turned by a percent or two
    np.testing.assert_allclose(force[:-1], 0.0, atol=0.03 * abs(force[-1]))


@parallel
def test_reaction_against_an_obstacle(mesh_file, run):
    """Two blocks on a plane that nothing else holds: the load goes through both contacts."""
    path = mesh_file("quadrilateral", 2, 3)
    plane = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0])
    scene = scene_of(
        path,
        "quadrilateral",
        contacts=[
            Contact("upper_bottom", "lower_top", name="pair"),
            Contact("lower_bottom", obstacle=plane, name="floor"),
        ],
        displacements=[Displacement("left", [0.0, "free"])],
        loads=[Load("upper_top", pressure=0.5)],
    )
    watch = Log()
    _, converged = run(scene, None, [watch])
    assert converged
    contacts = watch.records[-1]["contacts"]
    np.testing.assert_allclose(contacts["pair"]["force"], [0.0, -0.5], atol=1e-9)
    np.testing.assert_allclose(contacts["floor"]["force"], [0.0, -0.5], atol=1e-9)
    np.testing.assert_allclose(watch.records[-1]["reactions"]["left"], [0.0, 0.0], atol=1e-9)


@parallel
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_patch_test_with_nested_meshes(mesh_file, run, cell):
    """Uniform pressure through contact: every probe and pressure is exact when the meshes match."""
    d = DIMENSION[cell]
    path = mesh_file(cell, 2, 2)
    free = ["free"] * (d - 1)
    held = [Displacement("lower_bottom", [*free, 0.0]), Displacement("left", [0.0, "free", *free[1:]])]
    if d == 3:
        held.append(Displacement("front", ["free", 0.0, "free"]))
    scene = scene_of(path, cell, displacements=held, loads=[Load("upper_top", pressure=1.5)])
    scene.materials = {"soft": Material(10.0, 0.0), "hard": Material(30.0, 0.0)}
    watch = Log()
    simulation, converged = run(scene, None, [watch])
    assert converged
    record = watch.records[-1]
    assert record["contacts"]["pair"]["max_pressure"] == pytest.approx(1.5, abs=1e-8)
    np.testing.assert_allclose(
        record["probes"]["lower_top"]["mean"], [0.0] * (d - 1) + [-1.5 / 30], atol=1e-9
    )
    # the discrete gap of Nitsche's method is zero where the pressure is exact
    np.testing.assert_allclose(
        record["probes"]["upper_top"]["max"], [0.0] * (d - 1) + [-1.5 / 30 - 1.5 / 10], atol=1e-9
    )


# -- load steps ----------------------------------------


def ceiling():
    """A plane at the top of the lower block: against it the gap is linear, wherever the search was done.

    Between deformed bodies the frozen gap differs from the true one to second order of the displacement.
    """
    return Obstacle("plane", point=[0.0, 1.0], normal=[0.0, 1.0])


@parallel
@pytest.mark.parametrize("theta", [1.0, 0.0])
def test_many_steps_end_where_one_ends(mesh_file, run, theta):
    """Frictionless contact of flat surfaces that do not slide has no memory."""
    path = mesh_file("quadrilateral", 2, 2, gap=0.01)
    ends = []
    for count in (1, 4):
        scene = scene_of(path, "quadrilateral", theta, steps=Steps(1.0, count))
        scene.contacts = [Contact("upper_bottom", obstacle=ceiling(), name="pair", theta=theta)]
        watch = Log()
        simulation, converged = run(scene, None, [watch])
        assert converged and len(watch.records) == count and not watch.cuts
        ends.append((simulation.stepper.u.getArray().copy(), watch.records[-1]))
        simulation.close()
    np.testing.assert_allclose(ends[0][0], ends[1][0], atol=1e-10)
    assert ends[0][1]["contacts"]["pair"]["slip"] > 0
    np.testing.assert_allclose(
        ends[0][1]["contacts"]["pair"]["force"], ends[1][1]["contacts"]["pair"]["force"], atol=1e-9
    )


@parallel
def test_unloading_ends_at_rest(mesh_file, run):
    """Press and release: no stress is left, all corners of the amplitude are met."""
    path = mesh_file("quadrilateral", 2, 3)
    table = [(0.0, 0.0), (0.4, 1.0), (1.0, 0.0)]
    scene = scene_of(
        path,
        "quadrilateral",
        steps=Steps(1.0, 2),
        contacts=[Contact("upper_bottom", obstacle=ceiling(), name="pair")],
        displacements=[
            Displacement("lower_bottom", [0.0, 0.0]),
            Displacement("upper_top", [0.0, -0.02], table),
        ],
    )
    watch = Log()
    simulation, converged = run(scene, None, [watch])
    assert converged
    times = [record["time"] for record in watch.records]
    assert 0.4 in times and times[-1] == 1.0
    forces = {record["time"]: record["contacts"]["pair"]["force"][1] for record in watch.records}
    assert forces[0.4] < -0.05
    assert abs(forces[1.0]) < 1e-9
    assert simulation.stepper.u.norm(3) < 1e-9


@parallel
def test_more_ranks_than_cells_run_through(mesh_file, run, shared_tmp):
    """Two cells, a contact pair, fields and all."""
    path = mesh_file("quadrilateral", 1, 1)
    scene = scene_of(path, "quadrilateral", output=Output(fields=True, probes=["upper_origin"]))
    watch = Log()
    simulation, converged = run(scene, shared_tmp / "out", [watch])
    assert converged
    assert watch.records[-1]["contacts"]["pair"]["slip"] > 0
    assert len({json.dumps(r) for r in WORLD.allgather(watch.records[-1])}) == 1


@parallel
def test_wrong_input_in_python_is_refused_on_every_rank(mesh_file):
    scene = scene_of(mesh_file("quadrilateral"), "quadrilateral")
    scene.contacts[0].source = "upper_botom"
    before = PETSc.Options().getAll()
    with pytest.raises(InputError, match="upper_botom.*upper_bottom"):
        Simulation(scene)
    # nothing of the scene is left for the next one
    assert PETSc.Options().getAll() == before
    assert WORLD.allreduce(1) == WORLD.size
