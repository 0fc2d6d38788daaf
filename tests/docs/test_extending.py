"""The examples of docs/extending.md: what they add from outside the package does what they say."""

import re
from pathlib import Path

import numpy as np
import pytest

import pcontact as pc
from drivers._common import make_mesh, running
from drivers.cases import slider
from meshes import one_block
from pcontact.contact.formulation.methods import Penalty
from pcontact.contact.law import ADDED, OPEN, SLIP, STICK, View, contact_law
from pcontact.contact.pair import METHODS
from pcontact.material.hardening import hardening_table
from pcontact.material.laws import ADDED as LAWS_ADDED
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact, Displacement, Material
from pcontact.simulation import Simulation

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
F, S = 0.5, 2.0
WORLD = MPI.COMM_WORLD


@pytest.fixture
def law():
    """The law of the page, added while a test runs."""
    names = {}
    exec(BLOCKS[0], names)
    yield names["Saturated"](Contact("a", "b", friction=F, friction_limit=S))
    del ADDED["saturated"]


def test_examples_are_short():
    assert all(len(block.splitlines()) <= 60 for block in BLOCKS)
    assert "def bounded" not in BLOCKS[0], "a law of friction needs its bound alone"


def points(dim, n=200):
    """Random normals and augmented tractions: open, sticking and slipping points."""
    rng = np.random.default_rng(5)
    normal = rng.normal(size=(n, dim))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    return normal, 2.0 * rng.normal(size=(n, dim))


@pytest.mark.parametrize("dim", [2, 3])
def test_the_derivative_of_the_law(law, dim):
    normal, tau = points(dim)
    view = View(np.arange(len(tau)) % 7 > 0, False, False)
    slope = np.zeros((len(tau), dim, dim))
    traction, status = law.project(view, normal, tau, slope)
    assert {OPEN, STICK, SLIP} == set(status)
    assert not traction[~view.paired].any() and not slope[~view.paired].any()
    for step in np.eye(dim) * 1e-7:
        there, then = law.project(view, normal, tau + step)
        back, before = law.project(view, normal, tau - step)
        same = (then == status) & (before == status)
        wanted = slope @ step
        assert np.max(np.abs(0.5 * (there - back) - wanted)[same]) <= 1e-14


@pytest.mark.parametrize("bilateral", [False, True])
def test_a_bound_alone_is_a_law(bilateral):
    """Coulomb's, written as a bound: traction, status and derivative are those of the compiled one."""

    class Own(pc.FrictionLaw):
        def bound(self, pressure):
            return F * pressure, np.full_like(pressure, F)

    normal, tau = points(3)
    view = View(np.arange(len(tau)) % 7 > 0, bilateral, False)
    found = []
    for one in (Own(), contact_law(Contact("a", "b", friction=F))):
        slope = np.zeros((len(tau), 3, 3))
        found.append((*one.project(view, normal, tau, slope), slope))
    for ours, theirs in zip(*found, strict=True):
        np.testing.assert_allclose(ours[view.paired], theirs[view.paired], rtol=0, atol=1e-13)
    assert not Own().symmetric
    with pytest.raises(NotImplementedError, match="Bare has no method bound"):
        type("Bare", (pc.FrictionLaw,), {})().project(view, normal, tau)


def test_it_is_coulomb_below_its_limit(law):
    """Where F p is small against s."""
    normal, tau = points(2)
    view = View(np.ones(len(tau), dtype=bool), False, False)
    coulomb = contact_law(Contact("a", "b", friction=F))
    ours, _ = law.project(view, normal, 1e-6 * tau)
    theirs, _ = coulomb.project(view, normal, 1e-6 * tau)
    assert np.max(np.abs(ours - theirs)) <= 1e-6 * np.max(np.abs(theirs))


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("dim", [2, 3])
def test_a_block_slides_with_its_bound(law, shared_tmp, dim):
    """Pressed, then dragged: in the end all of it slips, and bears what the law says of the pressure at every point."""
    divisions, size = [8, *[4] * (dim - 2), 2], [1.0] * (dim - 1) + [0.2]
    path = make_mesh(one_block, shared_tmp / "block.msh", dim, divisions, size=size)
    scene = slider.scene(path, dim, {"law": "saturated", "friction": F, "friction_limit": S}, 0.02, count=10)
    scene.displacements[0].amplitude = [[0.0, 0.0], [0.2, 0.0], [1.0, 1.0]]
    with running(scene) as (simulation, converged):
        assert converged
        state = simulation.problem.contacts[0].state(simulation.stepper.u)
    closed = state["status"] != OPEN
    wanted = S * (1.0 - np.exp(-F * state["pressure"] / S))
    tangential = np.linalg.norm(state["traction"][:, :-1], axis=1)
    assert np.all(state["status"][closed] == SLIP)
    assert np.max(np.abs(tangential - wanted)[closed], initial=0.0) <= 1e-9 * S
    assert WORLD.allreduce(int(closed.sum())) > 0


def test_a_law_that_nobody_added(shared_tmp):
    path = make_mesh(one_block, shared_tmp / "block.msh", 2, (4, 2))
    scene = slider.scene(path, 2, {"law": "nobody"})
    with pytest.raises(InputError, match=r"law: found 'nobody'.*allowed: none"):
        Simulation(scene)


@pytest.mark.parametrize("other", [{"tresca": 1.0}, {"tied": True}])
def test_a_law_is_the_only_one(law, shared_tmp, other):
    path = make_mesh(one_block, shared_tmp / "block.msh", 2, (4, 2))
    with pytest.raises(InputError, match="together with law"):
        Simulation(slider.scene(path, 2, {"law": "saturated", **other}))


def test_a_formulation_of_springs(shared_tmp, monkeypatch):
    """A block pressed on a bed of springs, one in series with the other."""
    names = {"Penalty": Penalty, "np": np}
    exec(BLOCKS[4], names)
    monkeypatch.setitem(METHODS, "penalty", names["Springs"])
    path = make_mesh(one_block, shared_tmp / "block.msh", 2, (4, 2), size=[1.0, 0.5])
    scene = slider.scene(path, 2, {}, hold="flat", formulation="penalty", gamma0=50.0)
    scene.displacements = [Displacement("top", [0.0, -0.01])]
    scene.materials = {name: Material(1000.0, 0.0) for name in scene.materials}
    with running(scene) as (simulation, converged):
        assert converged
        pressure = simulation.problem.contacts[0].state(simulation.stepper.u)["pressure"]
    assert pressure == pytest.approx(0.01 / (1.0 / 50.0 + 0.5 / 1000.0), rel=1e-9)


def test_a_curve_of_hardening():
    """Where its straight segments meet, and in the middle of them."""
    names = {}
    exec(BLOCKS[5].partition("pc.read")[0], names)
    table = names["voce"](2.0, 4.0, 0.01)
    assert table[0].tolist() == [0.0, 2.0] and table[-1, 1] == pytest.approx(4.0, rel=5e-3)
    curve = hardening_table(table)
    between = 0.5 * (table[1:, 0] + table[:-1, 0])
    found = curve[:-1, 1] + curve[:-1, 2] * (between - table[:-1, 0])
    assert found == pytest.approx(4.0 - 2.0 * np.exp(-between / 0.01), rel=2e-3)


@pytest.mark.parallel
def test_a_law_of_creep(shared_tmp):
    """The stress of a bar that is held falls as backward Euler says of d sigma / dt = -E A sigma^n."""
    exec(BLOCKS[6], {})
    path = make_mesh(one_block, shared_tmp / "block.msh", 2, 2)
    scene = pc.from_dict({
        "mesh": {"file": str(path), "kinematics": "plane_stress"},
        "materials": {"m": {"E": 100.0, "nu": 0.3, "law": "norton", "parameters": [0.01, 3.0]}},
        "bodies": [{"region": "block", "material": "m"}], "steps": {"count": 4},
        "displacements": [
            {"region": "bottom", "value": ["free", 0.0]}, {"region": "left", "value": [0.0, "free"]},
            {"region": "top", "value": ["free", 0.02], "amplitude": [[0.0, 0.0], [1e-9, 1.0], [1.0, 1.0]]},
        ],
    })  # fmt: skip
    try:
        run = pc.run(scene)
    finally:
        del LAWS_ADDED["norton"]
    known = 2.0
    assert len(run.steps) == 5
    for step in run.steps[1:]:
        known = next(root.real for root in np.roots([0.25, 0.0, 1.0, -known]) if abs(root.imag) < 1e-12)
        assert step["reactions"]["top"][1] == pytest.approx(known, rel=1e-7)


@pytest.mark.parallel
def test_an_item_of_buffers(shared_tmp):
    """They alone hold the upper end of a bar whose lower end is moved: their force is that of the bar."""
    names = {}
    exec(BLOCKS[2].partition("run = ")[0], names)
    path = make_mesh(one_block, shared_tmp / "block.msh", 2, (1, 8), size=[1.0, 1.0])
    scene = pc.from_dict({
        "mesh": {"file": str(path)}, "materials": {"m": {"E": 100.0, "nu": 0.0}},
        "bodies": [{"region": "block", "material": "m"}],
        "displacements": [{"region": "bottom", "value": [0.0, 0.5]}], "output": {"probes": ["top"]},
    })  # fmt: skip
    k, c = 10.0, 1e3
    run = pc.run(scene, items=[lambda space: names["Buffers"](space, "top", k, c)])
    # two nodes, against a bar of the stiffness 100
    (wanted,) = (root.real for root in np.roots([2.0 * c, 0.0, 2.0 * k + 100.0, -50.0]) if abs(root.imag) < 1e-12)
    (step,) = run.steps
    assert step["probes"]["top"]["mean"] == pytest.approx([0.0, wanted], abs=1e-9)
    assert step["reactions"]["bottom"][1] == pytest.approx(2.0 * (k * wanted + c * wanted**3), rel=1e-9)
    assert step["newton"] <= 7 and step["imbalance"] < 1e-9
    with pytest.raises(pc.InputError, match="items in a run that reaches an error"):
        pc.run(scene, {"error": 0.1}, items=[lambda space: None])
