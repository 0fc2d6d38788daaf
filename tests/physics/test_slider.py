"""The sliding block: sticks below the bound of its law, slides with exactly that force, sticks when it is reversed."""

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases import slider
from meshes import one_block
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Load
from pcontact.simulation import Simulation

pytestmark = pytest.mark.slow
WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel(2, 3)
N = slider.PRESSURE  # normal force: the area is 1
MU = 0.3
CELLS = {2: (6, 2), 3: (4, 4, 1)}


class Watch(slider.Loop):
    """Also the sum of the sizes of all tangential tractions, the support force, and who sticks and slips."""

    def __init__(self, keys, comm):
        super().__init__(keys)
        self.comm, self.simulation = comm, None

    def step(self, step, u, record):
        super().step(step, u, record)
        state = self.simulation.problem.items[1].state(u)
        traction, normal = state["traction"], state["normal"]
        across = traction - np.einsum("pd,pd->p", traction, normal)[:, None] * normal
        row = self.rows[-1]
        row["rubbed"] = self.comm.allreduce(float(np.sum(np.linalg.norm(across, axis=1) * state["weight"])))
        row["support"] = record["reactions"].get("top")
        keys, parts = self.simulation.problem.items[1].source, self.comm.allgather
        x = np.concatenate(parts(keys.x))
        order = np.lexsort(np.round(x, 12).T)
        row["status"] = np.concatenate(parts(state["status"]))[order]


def mesh(path, dim, height=slider.HEIGHT):
    """Collective."""
    return make_mesh(one_block, path, dim, CELLS[dim], size=[*[1.0] * (dim - 1), height])


def loop(path, dim, keys, comm=WORLD, change=None, **said):
    """Rows of a run. Collective on `comm`."""
    case = slider.scene(path, dim, keys, **said)
    if change is not None:
        change(case)
    watch = Watch(keys, comm)
    watch.simulation = simulation = Simulation(case, comm)
    try:
        assert simulation.run(None, [watch])
    finally:
        simulation.close()
    return watch.rows


def check_balance(rows):
    """The support holds what the floor bears; the pressing force and the height are prescribed by no reaction."""
    for row in rows:
        assert row["support"][0] == pytest.approx(row["force"], abs=1e-8 * row["bound"])


@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_slides_with_mu_times_the_normal_force(tmp_path, dim, theta):
    rows = loop(mesh(tmp_path / "block.msh", dim), dim, {"friction": MU}, count=20, theta=theta)
    check_balance(rows)
    assert len(slider.sliding(rows)) >= 6
    for row in slider.sliding(rows):
        assert row["open"] == 0
        assert row["normal"] == pytest.approx(N, rel=1e-8)
        assert abs(row["force"]) == pytest.approx(MU * N, rel=1e-8)
    # forth, back, forth: against the way
    assert [np.sign(row["force"]) for row in rows if row["time"] in (0.4, 0.8, 1.0)] == [1, -1, 1]


@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_slides_with_much_friction(tmp_path, dim, theta):
    """A block so low that it does not tip; its front rises a little in the middle."""
    path = mesh(tmp_path / "block.msh", dim, 0.05)
    rows = loop(path, dim, {"friction": 1.5}, count=20, drag=0.008, theta=theta)
    check_balance(rows)
    found = slider.sliding(rows)
    assert len(found) >= 4
    for row in found:
        assert abs(row["force"]) == pytest.approx(1.5 * N, rel=1e-8)


@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
@pytest.mark.parametrize("hold", ["pressure", "flat"])
def test_sliding_friction_is_mu_times_what_presses(tmp_path, hold, theta):
    """In space with free sides, that bulge: the sizes of the tractions add up to mu N."""
    path = mesh(tmp_path / "block.msh", 3)
    rows = loop(path, 3, {"friction": MU}, hold=hold, guided=False, count=20, drag=0.02, theta=theta)
    found = slider.sliding(rows)
    assert len(found) >= 8
    for row in found:
        assert row["rubbed"] == pytest.approx(MU * row["normal"], rel=1e-12)


@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    ("law", "force"),
    [("tresca", slider.BOND), ("adhesion", MU * N + slider.BOND), ("low cap", 1.0), ("high cap", MU * N)],
)
def test_each_law_has_its_force(tmp_path, law, force, dim, theta):
    # low: at every point, the corners too; high: at none
    caps = {"low cap": 1.0, "high cap": 10.0 * MU * N}
    keys = {"friction": MU, "friction_limit": caps[law]} if law in caps else slider.law_keys(law, MU)
    path = mesh(tmp_path / "block.msh", dim)
    rows = loop(path, dim, keys, count=10, drag=0.004, theta=theta)
    check_balance(rows)
    found = slider.sliding(rows)
    assert len(found) >= 4
    for row in found:
        assert abs(row["force"]) == pytest.approx(force, rel=1e-8)
        assert row["bound"] == pytest.approx(force, rel=1e-8)


@parallel
@pytest.mark.parametrize(
    ("dim", "law", "theta"), [(2, "coulomb", 0.0), (2, "adhesion", 1.0), (2, "tresca", -1.0), (3, "coulomb", 0.0)]
)
def test_ranks_do_not_matter(shared_tmp, dim, law, theta):
    """The history against that of one rank."""
    path, keys = mesh(shared_tmp / "block.msh", dim), slider.law_keys(law, MU)
    # inexact linear solves would make Newton's path another on every number of ranks
    tight = {"snes_rtol": "1e-11", "snes_ksp_ew": "false", "ksp_rtol": "1e-10"}
    said = {"count": 20, "guided": False, "theta": theta, "petsc": tight}
    one = loop(path, dim, keys, SELF, **said)
    WORLD.Barrier()
    all_ = loop(path, dim, keys, WORLD, **said)
    for a, b in zip(one, all_, strict=True):
        for key in ("time", "open", "stick", "slip"):
            assert a[key] == b[key]
        assert np.array_equal(a["status"], b["status"])
        for key in ("force", "normal", "rubbed"):
            assert a[key] == pytest.approx(b[key], abs=1e-9 * a["bound"])


@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_sticks_as_stiffly_after_every_reversal(tmp_path, dim, theta):
    """The slope of force over way is that of the block glued to the plane, in small steps and in large ones."""
    path = mesh(tmp_path / "block.msh", dim)

    def glue(case):
        case.allow_unsafe = ["friction"]

    def rows_of(friction, count, drag):
        return loop(path, dim, {"friction": friction}, change=glue, count=count, theta=theta, drag=drag)

    def slopes(rows, turns):
        pairs = [(a, b) for a, b in zip(rows, rows[1:], strict=False) if a["time"] == pytest.approx(turns, abs=1e-9)]
        assert pairs and all(b["slip"] == b["open"] == 0 for _, b in pairs)
        return [(b["force"] - a["force"]) / (b["drag"] - a["drag"]) for a, b in pairs]

    (glued,) = slopes(rows_of(100.0, 10, 1e-6), 0.2)
    for count in (40, 160):
        rows = rows_of(MU, count, 0.004)
        for turns in (0.4, 0.8):
            assert slopes(rows, turns) == [pytest.approx(glued, rel=1e-3)]


@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
def test_a_force_below_the_bound_moves_nothing_in_time(tmp_path, theta):
    """Pulled by 0.6 of what friction bears, in few steps or in many, then held: the block stays where it is."""
    path = make_mesh(one_block, tmp_path / "block.msh", 2, (12, 4), size=[1.0, slider.HEIGHT])
    places = []
    for count in (4, 32):
        case = slider.scene(path, 2, {"friction": MU}, count=count, theta=theta)
        case.displacements = []
        pull = [(0.0, 0.0), (0.25, 0.0), (0.5, 1.0), (1.0, 1.0)]
        case.loads = [
            Load("top", pressure=N, amplitude=[(0.0, 0.0), (0.25, 1.0), (1.0, 1.0)]),
            Load("top", traction=[0.6 * MU * N, 0.0], amplitude=pull),
        ]
        watch = Watch({"friction": MU}, WORLD)
        watch.simulation = simulation = Simulation(case, WORLD)
        try:
            assert simulation.run(None, [watch])
        finally:
            simulation.close()
        held = [row for row in watch.rows if row["time"] > 0.49]
        # the edges of the block bear more than the middle, and slip
        assert held[-1]["slip"] < 0.4 * held[-1]["stick"]
        assert held[-1]["drag"] == pytest.approx(held[0]["drag"], rel=5e-3)
        places.append(held[-1]["drag"])
    assert places[1] == pytest.approx(places[0], rel=5e-3)
