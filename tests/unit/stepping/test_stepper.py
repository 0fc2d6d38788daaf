"""Where partners are looked for: where a load step is expected to end."""


import numpy as np
import pytest

from meshes import one_block
from pcontact.runtime.errors import StepFailure
from pcontact.runtime.petsc import MPI
from pcontact.scene.amplitude import drive
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene, Steps
from pcontact.simulation import Simulation
from pcontact.solve.convergence import NewtonResult
from pcontact.solve.problem import Features
from pcontact.stepping.schedule import Schedule
from pcontact.stepping.stepper import Stages, Stepper
from tests.support.records import Log

WORLD = MPI.COMM_WORLD
WAY = 0.02


def scene(path, table, end, **more):
    """A block that moves along its foundation, which is far enough below not to be touched."""
    ground = Obstacle("plane", point=[0.0, -0.01], normal=[0.0, 1.0])
    return Scene(
        mesh=MeshSpec(path),
        materials={"m": Material(1000.0, 0.3)},
        bodies=[Body("block", "m")],
        contacts=[Contact("bottom", obstacle=ground, name="ground")],
        displacements=[Displacement("block", [WAY, 0.0], table)],
        steps=Steps(end, int(end)),
        output=Output(fields=False),
        **more,
    )


def searches(case, begin=None, floats=False):
    """Time, displacement so far, displacement of the search: of every load step, along x. `begin`: from the time to the
    displacement (2,) that another run has told; `floats`: whether contact alone holds the block."""
    simulation, seen = Simulation(case), []
    item = simulation.problem.items[1]
    item.floats = floats
    if begin is not None:
        simulation.begin = lambda time: np.tile(begin(time), (simulation.problem.space.n_owned, 1))
    detect = item.detect

    def spy(u, time, motion=0.0, ahead=None):
        place = u if ahead is None else ahead
        places = [along_x(vector) for vector in (u, place)]
        seen.append((time, *places))
        detect(u, time, motion, ahead)

    item.detect = spy
    try:
        assert simulation.run()
    finally:
        simulation.close()
    return seen


def along_x(vector):
    """The value along x, the same for all nodes."""
    values = vector.getArray(readonly=True).reshape(-1, 2)[:, 0]
    low, high = (WORLD.allreduce(float(f(values, initial=s)), op=op)
                 for f, s, op in ((np.min, np.inf, MPI.MIN), (np.max, -np.inf, MPI.MAX)))  # fmt: skip
    assert high - low < 1e-12
    return low


@pytest.fixture
def block(shared_tmp):
    if WORLD.rank == 0:
        one_block(shared_tmp / "b.msh", 2, (4, 2))
    WORLD.Barrier()
    return shared_tmp / "b.msh"


@pytest.mark.parallel
def test_the_search_goes_with_the_amplitudes(block):
    """Slower, held, back, faster: the place is the one that the block then goes to, where a load step was before that
    tells the direction.
    """
    table = [(0, 0), (1, 1), (2, 1.5), (3, 1.5), (4, 2.0), (5, 1.5), (6, 2.5), (7, 9.0)]
    factor = dict(table)
    # without a direction, the committed place; no more than twice the last load step, no more than once back
    expected = {1: 0.0, 2: 1.5, 3: 1.5, 4: 1.5, 5: 1.5, 6: 2.0, 7: 4.5}
    for time, so_far, place in searches(scene(block, table, 7.0)):
        assert so_far == pytest.approx(WAY * factor[round(time) - 1], abs=1e-12)
        assert place == pytest.approx(WAY * expected[round(time)], abs=1e-12), time


@pytest.mark.parametrize("floats", [False, True])
def test_the_search_is_where_another_run_has_told_the_bodies(block, floats):
    """From the first load step on, whatever holds them; without it nobody knows where bodies go that float."""
    case = scene(block, [(0, 0), (1, 1), (2, 2)], 2.0)
    told = [place for _, _, place in searches(case, lambda time: [1.1 * time * WAY, 0.0], floats)]
    assert told == pytest.approx([1.1 * WAY, 2.2 * WAY], abs=1e-12)
    alone = [place for _, _, place in searches(case, floats=floats)]
    assert alone == pytest.approx([0.0, WAY * (2 - floats)], abs=1e-12)


def test_bodies_that_jump_do_not_go_on(block):
    """Farther than half a search radius in a load step: the committed place."""
    far = scene(block, [(0, 0), (1, 1), (2, 2)], 2.0)
    far.contacts[0].search_radius = 1.9 * WAY
    assert [place for _, _, place in searches(far)] == pytest.approx([0.0, WAY], abs=1e-12)


def test_which_bodies_jump_does_not_depend_on_the_axes(block):
    """As far along a slope, of which each component is less than half a search radius."""
    far = scene(block, [(0, 0), (1, 1), (2, 2)], 2.0)
    far.displacements[0].value = [0.6 * WAY, 0.8 * WAY]
    far.contacts[0].search_radius = 1.9 * WAY
    assert [place for _, _, place in searches(far)] == pytest.approx([0.0, 0.6 * WAY], abs=1e-12)


@pytest.mark.parametrize("imposed, goes_on", [(0.0, False), (1.0, True)])
def test_load_steps_after_a_jump_begin_where_the_bodies_are(block, imposed, goes_on):
    """Bodies with finite strain that have moved by a search radius, be it imposed on them or not."""
    simulation = Simulation(scene(block, [(0, 0), (2, 1)], 2.0))
    try:
        assert simulation.run()
        stepper, far = simulation.stepper, simulation.problem.others[0].radius
        stepper.u.set(far)
        stepper._last, stepper.schedule.time = (0.0, simulation.problem.space.vector()), 1.0
        assert (stepper._continued(2.0, imposed * far) is not None) == goes_on
    finally:
        simulation.close()


def test_what_drives_a_scene(block):
    """Displacements, loads and moving obstacles; not what is zero, or stands still."""
    ball = Obstacle("sphere", center=[0.5, 2.0], radius=0.5, displacement=[0.0, -0.1], amplitude=[(0, 0), (4, 2)])
    wave = Obstacle("level_set", function=lambda x, t: x[:, 1])
    case = scene(block, [(0, 0), (2, 1), (4, 0)], 4.0, loads=[Load("top", pressure=1.0)])
    case.displacements.append(Displacement("bottom", ["free", 0.0]))
    case.contacts += [Contact("top", obstacle=ball, name="ball"), Contact("left", obstacle=wave, name="wave")]
    factors = drive(case, np.zeros((1, 2)))
    np.testing.assert_allclose(factors(1.0), [0.5, 0.25, 0.5, 0.25])
    np.testing.assert_allclose(factors(3.0), [0.5, 0.75, 1.5, 0.75])


class Number:
    """A "displacement" that can do what the stepper asks of a vector."""

    def __init__(self, value=0.0):
        self.value = value

    def copy(self, other=None):
        if other is None:
            return Number(self.value)
        other.value = self.value
        return other


class MadeUp:
    """Problem, space and item at once, with a record of who called what."""

    continues, features = False, Features()

    def __init__(self):
        self.space, self.items, self.others, self.time, self.calls = self, [self], [], 0.0, []
        self.conditions = self.prediction = self

    def vector(self):
        return Number()

    def imposed(self, u, time):
        return 0.0

    def detect(self, u, time, motion, ahead):
        self.calls.append(("detect", u.value, time))

    def commit(self, u, time):
        self.calls.append(("commit", u.value, time))

    def begin(self, u, time, ahead=None):
        u.value = time

    def unbalanced(self, u):
        return np.zeros((1, 1))


class Solver:
    """Converges if the step is short enough; spoils the state in any case."""

    norms = (1.0, 0.0)

    def __init__(self, problem, longest):
        self.problem, self.longest, self.last = problem, longest, 0.0

    def solve(self, u):
        u.value += 100.0
        good = self.problem.time - self.last <= self.longest
        self.last = self.problem.time if good else self.last
        return NewtonResult(good, 4, 9, "because", 1e-9, 1.0)


def stepper(longest, smallest=1e-3, count=2):
    problem, watch = MadeUp(), Log()
    timing = {"search": 0.0, "solve": 0.0}
    schedule = Schedule(1.0, count, smallest)

    def recorder(step, u):
        return step

    return Stepper(problem, Solver(problem, longest), schedule, [watch], recorder, timing), problem, watch


def test_stepper_detects_solves_and_commits():
    loop, problem, watch = stepper(1.0)
    loop.run()
    assert problem.calls == [
        ("detect", 0.0, 0.5),
        ("commit", 100.5, 0.5),
        ("detect", 100.5, 1.0),
        ("commit", 101.0, 1.0),
    ]
    assert [(s.number, s.time, s.newton, s.krylov, s.cutbacks) for s in watch.records] == [
        (1, 0.5, 4, 9, 0),
        (2, 1.0, 4, 9, 0),
    ]


def test_observers_are_told_of_the_last_load_step_alone():
    """But of all where records sum up works."""
    for energy, told in ((None, [4]), ("balance", [1, 2, 3, 4])):
        loop, problem, watch = stepper(1.0, count=4)
        loop.every, loop._stages = False, Stages(energy=energy)
        loop._unbalanced = lambda before, begin, target: None
        loop.run()
        assert [step.number for step in watch.records] == told and problem.calls[-1] == ("commit", 101.0, 1.0)


def test_a_cut_back_undoes_everything():
    """The failed attempt leaves nothing behind: the next search is done on the committed state."""
    loop, problem, watch = stepper(0.2)
    loop.run()
    assert watch.cuts[:2] == [0.5, 0.25]
    assert [c for c in problem.calls if c[0] == "detect"][:3] == [
        ("detect", 0.0, 0.5),
        ("detect", 0.0, 0.25),
        ("detect", 0.0, 0.125),
    ]
    assert [c[2] for c in problem.calls if c[0] == "commit"] == [s.time for s in watch.records]
    assert watch.records[0].cutbacks == 2
    assert sum(s.cutbacks for s in watch.records) == len(watch.cuts)
    assert watch.records[-1].time == 1.0


def test_a_step_that_never_converges():
    loop, problem, watch = stepper(0.0, smallest=0.2)
    with pytest.raises(StepFailure, match="0 to 0.25 .*1.000e-09.* 4 "):
        loop.run()
    assert watch.records == [] and watch.cuts == [0.5, 0.25]
    assert loop.u.value == 0.0
