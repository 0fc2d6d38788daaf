"""Errors that are not of the mesh: measured together, and each alone where they are large."""

from dataclasses import replace

import pytest

from drivers.studies._named_scenes import HELD_BACK
from pcontact.adapt.mark import LEAP
from pcontact.adapt.passes import Pass, Watch
from pcontact.adapt.secondary import Secondary, Told, answers, change_to, more_steps
from pcontact.adapt.settings import Settings
from pcontact.runtime.options import Options
from pcontact.scene.target import Target
from pcontact.simulation import Simulation


@pytest.fixture(scope="module")
def sheared(tmp_path_factory):
    """Blocks pressed and sheared with friction, in four load steps: the simulation that has run, what it has told, and
    the settings."""
    scene = HELD_BACK["sheared"].scene(tmp_path_factory.mktemp("sheared"))
    settings = Settings(scene, Target(0.1), Options())
    simulation = Simulation(settings.scene())
    watch = Watch(simulation)
    assert simulation.run(None, [watch], keep=True)
    yield simulation, watch, settings
    simulation.free()


def told(sheared, error, of="energy", last=True):
    simulation, watch, settings = sheared
    target = Target(error, of)
    size = watch.norm if of == "energy" else 1.0
    done = Pass(simulation.problem.space.n_dofs, 30, 1, 0.2, None,
                {"mesh": min(0.2, error), "algebraic": 0.0}, steps=4)  # fmt: skip
    settings.goal = error
    secondary = Secondary(target, settings)
    return secondary, secondary.parts(simulation, watch, done, size, last), done, size


@pytest.mark.parametrize("of", ["energy", "support:upper_top"])
def test_load_steps_are_told_by_one_run(sheared, of):
    """What they are said to leave is what many more of them change; the usual quadrature is not tried."""
    simulation, watch, settings = sheared
    _, (parts, toward), done, size = told(sheared, 0.5, of)
    assert set(parts) == {"load_steps"} and done.trials > 0.0
    if of != "energy":
        assert abs(toward) == pytest.approx(parts["load_steps"])
        return
    scene = settings.scene()
    scene.output.estimate = False
    for _ in range(4):
        scene = more_steps(scene, 1)
    other = answers(simulation, scene, Target(0.1, of))[of]
    left = abs(change_to(simulation, other, Target(0.1, of), watch.record)) / size
    assert other.number == 64 and 0.7 * left < parts["load_steps"] < 2.5 * left


def test_a_quadrature_that_is_chosen_is_tried(sheared, monkeypatch):
    """Two points on a facet."""
    monkeypatch.setattr(sheared[0].scene.contacts[0], "quadrature", 3)
    _, (parts, _), _, _ = told(sheared, 0.5)
    assert set(parts) == {"load_steps", "quadrature"} and 0.0 < parts["quadrature"] < 0.1


def test_it_is_measured_once_and_again_where_it_is_large(sheared, monkeypatch):
    """Nothing follows it from mesh to mesh but the number of load steps."""
    secondary, (parts, _), done, size = told(sheared, 0.5)
    simulation, watch, settings = sheared
    measured = []

    def measure(self, simulation, watch, done, size):
        measured.append(done.unknowns)
        return Told({"load_steps": 0.1}, 0.0, done.steps)

    monkeypatch.setattr(Secondary, "_measured", measure)
    # far from the target it is not measured at all; where the next mesh may be the last one it is
    far = replace(done, unknowns=20 * done.unknowns, parts={"mesh": 1.01 * 0.5 * LEAP**0.5})
    near = replace(far, parts={"mesh": 0.99 * 0.5 * LEAP**0.5})
    for one, again in ((far, False), (near, True)):
        measured.clear()
        other = Secondary(Target(0.5), settings)
        found = other.parts(simulation, watch, one, size)
        assert bool(measured) == again == other.known and found == (({"load_steps": 0.1}, 0.0) if again else ({}, 0.0))
    # many more cells do not tell it again
    measured.clear()
    then = replace(done, unknowns=20 * done.unknowns)
    assert secondary.parts(simulation, watch, then, size)[0] == parts and not measured
    secondary._told = Told({"load_steps": 0.1}, 0.0, done.steps)
    assert secondary.parts(simulation, watch, replace(then, steps=40), size)[0] == {"load_steps": pytest.approx(0.01)}
    assert secondary.of_steps(8) == pytest.approx(0.05)
    # what is large is measured again where it misses the target, and not where finer meshes are to come anyway
    for mesh, left in ((0.2, 0.1), (0.05, 0.4), (0.6, 0.1), (1.3, 0.4)):
        secondary._told = Told({"load_steps": 0.4}, 0.0, done.steps)
        then = replace(done, parts={"mesh": mesh})
        assert secondary.parts(simulation, watch, then, size)[0] == {"load_steps": left}


