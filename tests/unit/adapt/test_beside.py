"""What is known of errors that the mesh has no part in."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcontact.adapt import beside, trials
from pcontact.adapt.beside import LIKELY, MOST_GROWTH, OFF, Beside
from pcontact.adapt.settings import FACETS, FALLING
from pcontact.scene.target import Target

CHANGE = 3e-4


def _pass(mesh):
    return SimpleNamespace(parts={"mesh": mesh}, steps=4, trials=0.0, unknowns=100)


@pytest.fixture
def run(monkeypatch):
    """A run with friction whose settings together change a force by `CHANGE`; twice the load steps change it by 1 %."""
    monkeypatch.setattr(trials.variants, "difference", lambda *_: -CHANGE)
    monkeypatch.setattr(trials.variants, "answer", lambda *_: None)
    monkeypatch.setattr(trials.variants, "change_to", lambda *_: 0.01)
    monkeypatch.setattr(trials.variants, "bent", lambda _: True)
    scene = SimpleNamespace(remembers=True, plastic=False, frictional=True, temperatures=[], petsc={},
                            steps=SimpleNamespace(count=1), output=SimpleNamespace(),
                            contacts=[SimpleNamespace(tied=False)])  # fmt: skip
    for name in ("with_steps", "searching", "finer_quadrature", "smooth_facets"):
        monkeypatch.setattr(trials.variants, name, lambda one, *_: one)
    problem = SimpleNamespace(linear=False, others=["a contact"], space=SimpleNamespace(degree=2))
    simulation = SimpleNamespace(problem=problem, scene=scene, close=lambda: None, mesh=SimpleNamespace(curved=True))
    settings = SimpleNamespace(scene=lambda: scene, staying=FACETS, falling=FALLING, searches=False)
    return simulation, Beside(Target(0.01, "force:face"), settings)


WATCH = SimpleNamespace(known=None)


def test_what_several_settings_change_together_counts_once(run):
    """With its sign; each of them may be as large. Load steps are expected to leave less than what is named."""
    simulation, errors = run
    parts, toward = errors.parts(simulation, _pass(0.04), 1.0, WATCH)
    assert parts["frozen_partners"] == parts["quadrature"] == parts["curved_facets"] == CHANGE
    steps = toward.pop("load_steps")
    assert 0.01 < steps == LIKELY[False] * parts["load_steps"]
    assert errors.unsure(parts) == OFF[False] * parts["load_steps"]
    assert sum(toward.values()) == pytest.approx(-CHANGE) and len(toward) == 3
    assert sum(errors.once(parts).values()) == pytest.approx(CHANGE + parts["load_steps"])


@pytest.mark.parametrize("value", [2e-5, float("nan")])
def test_quadrature_is_measured_on_meshes_where_it_seems_to_be_much(run, monkeypatch, value):
    """To first order, without a sign, as something remembers; what is not known falls as the mesh's part does."""
    simulation, errors = run
    monkeypatch.setattr(trials.variants, "difference", lambda *_: 0.3)
    monkeypatch.setattr(beside.linearised, "changes", lambda *_: {"quadrature": value})
    first, toward = errors.parts(simulation, _pass(0.04), 1.0, WATCH)
    assert first["quadrature"] == toward["quadrature"] == 0.3
    parts, toward = errors.parts(simulation, _pass(0.02), 1.0, WATCH)
    known = value == value
    assert parts["quadrature"] == pytest.approx(value if known else 0.15)
    assert ("quadrature" in toward) != known
    monkeypatch.setattr(beside.linearised, "changes", None)
    if known:
        assert errors.parts(simulation, _pass(0.01), 1.0, WATCH)[0]["quadrature"] == pytest.approx(0.5 * value)


def test_how_the_error_of_load_steps_grows_is_told_by_two_meshes(run):
    """From a coarse mesh to one with ten times the unknowns it has become twice as large."""
    simulation, errors = run
    simulation.scene.plastic = True
    first = _pass(0.04)
    errors.parts(simulation, first, 1.0, WATCH)
    assert not errors.follows and errors.grows == 0.0
    finer = SimpleNamespace(**{**vars(_pass(0.02)), "unknowns": 1000, "steps": 8})
    errors.with_steps(2.0 * errors.of_steps(8), finer, 1.0)
    assert errors.follows and errors.grows == finer.steps_grow == pytest.approx(np.log10(2.0))
    assert errors.may_have_grown(10_000) == 1.0
    last = SimpleNamespace(**{**vars(_pass(0.01)), "unknowns": 10_000, "steps": 8})
    assert errors.parts(simulation, last, 1.0, WATCH)[0]["load_steps"] == pytest.approx(2.0 * errors.of_steps(8))


@pytest.mark.parametrize("yields, contacts, times", [(True, 1, 10.0), (True, 0, 1.0), (False, 1, 1.0)])
def test_how_much_one_mesh_may_have_missed_of_the_error_of_load_steps(run, yields, contacts, times):
    """Where contacts move over yielding cells, and the meshes are finer."""
    simulation, errors = run
    simulation.scene.plastic, simulation.problem.others = yields, ["a contact"] * contacts
    errors.parts(simulation, _pass(0.04), 1.0, WATCH)
    assert errors.may_have_grown(50) == 1.0
    assert errors.may_have_grown(100 * 10.0 ** (1.0 / MOST_GROWTH)) == pytest.approx(times)


def test_facets_are_measured_anew_with_more_load_steps_where_bodies_rub(run, monkeypatch):
    """What they change in a number: few load steps may have rubbed otherwise. Not with as many."""
    simulation, errors = run
    monkeypatch.setattr(trials.variants, "difference", lambda *_: 0.3)
    monkeypatch.setattr(beside.linearised, "changes", lambda *_: {"quadrature": 0.0})
    first, _ = errors.parts(simulation, _pass(0.04), 1.0, WATCH)
    monkeypatch.setattr(trials.variants, "difference", lambda *_: -1e-4)
    again, _ = errors.parts(simulation, _pass(0.04), 1.0, WATCH)
    assert first["curved_facets"] == again["curved_facets"] == 0.3
    more = _pass(0.04)
    more.steps = 8
    parts, toward = errors.parts(simulation, more, 1.0, WATCH)
    assert parts["curved_facets"] == -toward["curved_facets"] == 1e-4


@pytest.mark.parametrize("steps", [1, 2])
def test_other_settings_are_tried_with_the_load_steps_that_change_much(run, monkeypatch, steps):
    """Twice as many as the run has had: few of them rub otherwise. Not where no more have been taken."""
    simulation, errors = run
    simulation.stepper = SimpleNamespace(number=1)
    monkeypatch.setattr(trials.variants, "difference", lambda *_: 0.3)
    monkeypatch.setattr(trials.variants, "answer", lambda *_: SimpleNamespace(number=steps))
    monkeypatch.setattr(trials.variants, "change_between", lambda *_: -2e-4)
    parts, toward = errors.parts(simulation, _pass(0.04), 1.0, WATCH)
    assert parts["curved_facets"] == abs(toward["curved_facets"]) == (2e-4 if steps == 2 else 0.3)
