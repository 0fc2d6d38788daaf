"""Whole runs of a block that yields under a rigid cylinder: ranks, restart, cut back, Newton's method."""

from dataclasses import replace

import numpy as np
import pytest

from meshes.blocks import one_block
from pcontact.estimate.stress import mean_flow
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Scene, Steps
from pcontact.simulation import Simulation
from tests.support.kinematics import DIRECT, mesh
from tests.support.restarts import STOP, Keep
from tests.support.small import keys

pytestmark = pytest.mark.slow
WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel(2, 3)
THETAS = [1.0, 0.0, -1.0]
E, YIELD, STRAIN = 200.0, 0.5, 0.5 / 200.0
# inexact linear solves would make Newton's path another on every number of ranks
TIGHT = {"snes_rtol": "1e-11", "snes_ksp_ew": "false", "ksp_rtol": "1e-10"}
# down in five steps, up again as long as it touches in three
WAY = [(0.0, 0.0), (0.625, 1.0), (1.0, 0.94)]


def indentation(
    path, theta=0.0, friction=0.3, order=1, stops=(), count=8, petsc=None, depth=0.06, adjoint="elastic", **said
):
    """A cylinder pressed into a block and taken away."""
    cylinder = Obstacle("sphere", center=[1.0, 2.0], radius=1.0, displacement=[0.0, -depth], amplitude=WAY)
    times = [(0.0, 0.0), *((t, 1.0) for t in stops)] if len(stops) else None
    numerics = {"friction": friction, "theta": theta, "adjoint": adjoint}
    return Scene(
        mesh=MeshSpec(path, order=order),
        materials={"m": Material(E, 0.3, YIELD, 2.0, 3.0)},
        bodies=[Body("block", "m")],
        contacts=[Contact("top", obstacle=cylinder, name="cylinder", **numerics)],
        # corners of the factor are met by the load steps
        displacements=[Displacement("bottom", [0.0, 0.0], times)],
        steps=Steps(1.0, count),
        output=Output(fields=False, checkpoint=True),
        petsc=TIGHT if petsc is None else petsc,
        **said,
    )


class Look(Observer):
    """Force, contact, plastic strain, displacement of all nodes of every step; the internal variables at the end."""

    def __init__(self, comm):
        self.comm, self.rows, self.cuts, self.simulation, self.final = comm, [], 0, None, None

    def everywhere(self, number, values):
        """Rows of all ranks in the order of their numbers."""
        number, values = (np.concatenate(self.comm.allgather(part)) for part in (number, values))
        return values[np.argsort(number)]

    def step(self, step, u, record):
        bulk, pair = self.simulation.problem.items
        space, state = bulk.space, pair.state(u)
        largest, volume = bulk.plasticity()
        p = self.everywhere(
            np.concatenate([block.ids for block in space.mesh.blocks]), np.concatenate(bulk.plastic_strain())
        )
        moved = self.everywhere(keys(space)[space.owned_local], u.getArray(readonly=True).reshape(-1, space.dim).copy())
        points = pair.source.point_keys()
        self.rows.append({
            "time": step.time, "newton": step.newton, "norms": step.norms, "cutbacks": step.cutbacks,
            "force": np.array(record["contacts"]["cylinder"]["force"]), "largest": largest, "volume": volume, "p": p,
            "u": moved, "status": self.everywhere(points, state["status"]),
            "pressure": self.everywhere(points, state["pressure"]),
        })  # fmt: skip

    def cut(self, target, outcome):
        self.cuts += 1


def run(scene, comm, directory=None, observers=(), restart=None, change=None):
    """What `Look` saw. Collective on `comm`."""
    look = Look(comm)
    if restart is not None:
        PETSc.Options().setValue("restart", str(restart))
    look.simulation = simulation = Simulation(scene, comm)
    if change is not None:
        change(simulation)
    try:
        assert simulation.run(directory, [look, *observers])
    finally:
        simulation.close()
        PETSc.Options().delValue("restart")
    comm.Barrier()
    return look


def difference(a, b):
    """Largest difference of two steps, relative to the largest number of its kind or what first yield makes of it.

    On several ranks sums come in any order: a run that is repeated differs from itself by some 1e-13.
    """
    worst, first = 0.0, {"force": YIELD, "largest": STRAIN, "p": STRAIN, "u": STRAIN, "pressure": YIELD, "volume": 1.0}
    for key, scale in first.items():
        x, y = np.asarray(a[key]), np.asarray(b[key])
        worst = max(worst, float(np.max(np.abs(x - y)) / max(scale, np.max(np.abs(x)))))
    return worst


@pytest.fixture
def block(shared_tmp):
    return mesh(one_block, shared_tmp / "block.msh", 2, (10, 5), size=(2.0, 1.0))


def compare(first, second, tolerance):
    """Same steps, same status of all points, same numbers."""
    for a, b in zip(first, second, strict=True):
        assert a["time"] == b["time"]
        np.testing.assert_array_equal(a["status"], b["status"])
        assert difference(a, b) < tolerance


def check_history(rows):
    """Contact, plastic flow while the cylinder goes down, less force while it goes up."""
    force = np.array([row["force"][1] for row in rows])
    time, largest = np.array([row["time"] for row in rows]), np.array([row["largest"] for row in rows])
    down = time <= 0.625
    assert np.all(np.diff(force[down]) > 0.0) and np.all(np.diff(largest[down]) > 0.0) and largest.max() > 0.05
    assert 0.1 < force[-1] / force.max() < 0.9 and (~down).sum() >= 3
    assert all(len(set(row["status"])) > 1 for row in rows)


# -- ranks, restart -----------------------------------------------------------


@parallel
@pytest.mark.parametrize("theta, friction, order", [(0.0, 0.3, 1), (1.0, None, 1), (-1.0, 0.3, 2)])
def test_ranks_do_not_matter(block, shared_tmp, theta, friction, order):
    scene = [indentation(block, theta, friction, order) for _ in range(2)]
    one = run(scene[0], SELF).rows
    WORLD.Barrier()
    check_history(one)
    compare(one, run(scene[1], WORLD).rows, 1e-9)


@parallel
@pytest.mark.parametrize("theta, friction", [(0.0, 0.3), (-1.0, None)])
@pytest.mark.usefixtures("one_order")
def test_restart_gives_the_same_numbers(block, shared_tmp, theta, friction):
    """After a step in which the block yields, on as many ranks."""
    out, dead = shared_tmp / "out", shared_tmp / "dead"
    full = run(indentation(block, theta, friction), WORLD, out, [Keep(out, dead, WORLD)]).rows
    again = run(indentation(block, theta, friction), WORLD, shared_tmp / "again", restart=dead).rows
    assert full[STOP]["largest"] > 1.05 * full[STOP - 1]["largest"] > 0.0
    assert [row["newton"] for row in full[STOP:]] == [row["newton"] for row in again]
    compare(full[STOP:], again, 1e-12)


@parallel
def test_restart_on_other_ranks(block, shared_tmp):
    """Written by all ranks and read by one, and the other way round."""
    out, dead = shared_tmp / "out", shared_tmp / "dead"
    full = run(indentation(block), WORLD, out, [Keep(out, dead, WORLD)]).rows
    alone = run(indentation(block), SELF, shared_tmp / f"alone{WORLD.rank}", restart=dead).rows
    mine, copy = shared_tmp / f"single{WORLD.rank}", shared_tmp / f"copy{WORLD.rank}"
    single = run(indentation(block), SELF, mine, [Keep(mine, copy, SELF)]).rows
    WORLD.Barrier()
    together = run(indentation(block), WORLD, shared_tmp / "together", restart=shared_tmp / "copy0").rows
    for other in (alone, single[STOP:], together):
        compare(full[STOP:], other, 1e-9)


@parallel
def test_what_cells_have_missed_stays(block):
    """Where bodies yield, as far as cells flowed meanwhile: also when the cylinder is gone."""
    scene, seen = indentation(block, order=2, friction=None), []
    scene.output.estimate = True

    class Estimates(Observer):
        def step(self, step, u, record):
            found = simulation.error_estimate
            flow = mean_flow(simulation.mesh.blocks, simulation.problem.bulk)
            seen.append((found.over_steps, found.squares, np.concatenate(found.cells), flow))

    simulation = Simulation(scene, WORLD)
    try:
        assert simulation.run(None, [Estimates()])
    finally:
        simulation.free()
    over, squares, cells, flow = (np.array(one) for one in zip(*seen, strict=True))
    kept = (np.diff(flow, axis=0, prepend=0.0) * cells).sum(axis=0)
    kept = np.divide(kept, flow[-1], out=np.zeros_like(kept), where=flow[-1] > 0.0)
    assert squares[-1] == pytest.approx(np.maximum(kept, cells[-1]) ** 2)
    assert over[-1] ** 2 == pytest.approx(WORLD.allreduce(squares[-1].sum()))
    stays = WORLD.allreduce(np.array([(kept > cells[-1]).sum(), (kept**2).sum(), (cells[-1] ** 2).sum()]))
    assert stays[0] > 0 and stays[1] > 0.1 * stays[2]


@parallel
def test_restart_before_anything_yields(block, shared_tmp):
    """A checkpoint without internal variables, on ranks which never have any, too."""
    out, dead = shared_tmp / "out", shared_tmp / "dead"
    full = run(indentation(block, depth=1e-5), WORLD, out, [Keep(out, dead, WORLD)]).rows
    again = run(indentation(block, depth=1e-5), WORLD, shared_tmp / "again", restart=dead).rows
    assert full[-1]["largest"] == 0.0
    compare(full[STOP:], again, 1e-12)


# -- cut back -----------------------------------------------------------------


def same_times(block, rows, **said):
    """The run without a failure whose steps end at the same times."""
    return run(indentation(block, stops=[row["time"] for row in rows], **said), WORLD)


@parallel
@pytest.mark.parametrize("theta, friction", [(0.0, 0.3), (1.0, None)])
@pytest.mark.usefixtures("one_order")
def test_a_cut_back_leaves_no_trace(block, shared_tmp, theta, friction):
    """Steps that are solved and then refused, one while the block yields, one while it is let go."""
    refused = []

    def refuse(simulation):
        solve, problem = simulation.newton.solve, simulation.problem

        def solve_and_refuse(u, *follow):
            outcome = solve(u)
            if len(refused) < 2 and problem.time in (0.5, 0.75):
                refused.append(problem.time)
                outcome.converged = False
            return outcome

        simulation.newton.solve = solve_and_refuse

    cut = run(indentation(block, theta, friction), WORLD, change=refuse)
    assert cut.cuts == 2 and refused == [0.5, 0.75] and 0.625 in [row["time"] for row in cut.rows]
    plain = same_times(block, cut.rows, theta=theta, friction=friction)
    assert plain.cuts == 0
    compare(cut.rows, plain.rows, 1e-12)


@parallel
def test_steps_too_large_for_newton(block, shared_tmp):
    """Few iterations allowed: steps fail on their own, and the block remembers nothing of the attempts."""
    short = {**TIGHT, "snes_max_it": "5"}
    cut = run(indentation(block, friction=None, count=2, petsc=short), WORLD)
    assert cut.cuts > 0
    plain = same_times(block, cut.rows, friction=None, count=2)
    assert plain.cuts == 0
    compare(cut.rows, plain.rows, 1e-12)


# -- Newton's method ----------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("friction", [None, 0.3])
@pytest.mark.parametrize("theta", THETAS)
def test_quadratic_convergence(block, theta, friction, order):
    """Exact linear solves: the last residuals are of the size of the square of those before, also with the elastic
    adjoint of theta = 1 and -1.
    """
    exact = {**DIRECT, "snes_rtol": "1e-12"}
    rows = run(indentation(block, theta, friction, order, petsc=exact), WORLD).rows
    check_history(rows)
    constants = []
    for row in rows:
        part = np.array(row["norms"]) / row["norms"][0]
        # the two last iterations above rounding errors; before them points may still change their status
        part = part[part > 1e-13]
        constants += [b / a**2 for a, b in zip(part[-3:], part[-2:], strict=False) if a < 1e-3]
    assert len(constants) >= 5 and max(constants) < 2e3


class Balance(Observer):
    """Imbalance and algebraic error of every step."""

    def __init__(self):
        self.imbalance, self.algebraic = [], []

    def step(self, step, u, record):
        self.imbalance.append(record["imbalance"])
        self.algebraic.append(record["estimate"]["algebraic"] / record["estimate"]["energy_norm"])


@parallel
@pytest.mark.parametrize("theta", [1.0, -1.0])
def test_forces_are_those_that_newton_has_balanced(block, theta):
    """The consistent adjoint is another one as soon as the plastic strain is committed: supports and the algebraic
    error are those before.
    """
    scene = indentation(block, theta, adjoint="consistent", petsc={**DIRECT, "snes_rtol": "1e-11"})
    balance = Balance()
    run(replace(scene, output=replace(scene.output, estimate=True)), WORLD, observers=[balance])
    assert max(balance.imbalance) < 1e-10
    assert max(balance.algebraic) < 1e-8


@pytest.mark.parametrize(
    "theta, adjoint, warns", [(1.0, "consistent", True), (0.0, "consistent", False), (-1.0, "elastic", False)]
)
def test_several_solutions_are_warned_of(block, caplog, theta, adjoint, warns):
    """Where the residual jumps."""
    Simulation(indentation(block, theta, adjoint=adjoint), SELF).close()
    assert any("contact cylinder" in line and "more than one solution" in line for line in caplog.messages) == warns
