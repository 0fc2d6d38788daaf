"""Multipliers that two surfaces share, how fast they settle, and when a load step is not cut for them."""

import re

import numpy as np
import pytest

from drivers._common import contact_points, make_mesh, running
from drivers.cases.disk_on_block import scene as disk_scene
from drivers.cases.hertz import generate
from drivers.studies import compare
from meshes import c_strip, disk_on_block, two_blocks
from pcontact.contact.formulation.methods import AugmentedLagrangian, update_multipliers
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact, Steps
from pcontact.simulation import Simulation
from pcontact.stepping.load_step import rate
from tests.support.blocks import blocks, dragged, made, pressed
from tests.support.self_contact import strip
from tests.support.small import SELF

WORLD = MPI.COMM_WORLD
AUGMENTED = "augmented_lagrangian"
# multipliers settle among partners that stay: these are deep for small strain
STAY = {"contact_search_again": "0"}
LU = {"snes_rtol": "1e-12", "ksp_type": "preonly", "pc_type": "lu", **STAY}


class Watch(Observer):
    """Observer: records of the load steps, and what was cut."""

    def __init__(self):
        self.records, self.cuts = [], []

    def step(self, step, u, record):
        self.records.append(record)

    def cut(self, target, outcome):
        self.cuts.append(outcome.reason)


def run(case, measure=lambda simulation: None, comm=None):
    """Records of the load steps and what `measure` makes of the run, which cuts nothing back. Collective."""
    watch, simulation = Watch(), Simulation(case, comm or WORLD)
    try:
        assert simulation.run(observers=[watch])
        assert not watch.cuts
        return watch.records, measure(simulation)
    finally:
        simulation.close()


def settled(records, updates):
    """Whether all load steps settled within some updates."""
    return all(step["uzawa"]["updates"] <= updates and step["uzawa"]["change"] <= 1e-4 for step in records)


# -- the mean over both surfaces ----------------------------


@pytest.mark.parametrize("order, widths", [(1, None), (2, (1.0, 0.6))])
def test_the_largest_eigenvalue_of_an_update(tmp_path, monkeypatch, order, widths):
    """Contact that does not open is linear; a mean over the points of each surface alone has the eigenvalue 1."""
    path = two_blocks(tmp_path / "b.msh", 2, 3, 4, "quadrilateral", widths=widths)
    case = dragged(path, 2, order, bilateral=True)
    case.petsc = {**LU, "contact_uzawa_max_it": "1"}
    monkeypatch.setattr("pcontact.stepping.load_step.CREEP", np.inf)

    def measure(simulation):
        u, parts = simulation.stepper.u, simulation.problem.contacts[0].pairs
        kept = [part.method.multiplier for part in parts]
        normals = [part.pairing.normal for part in parts]

        def updated():
            simulation.newton.again(u)
            update_multipliers(parts, u, 0.0)
            new = [part.method.multiplier for part in parts]
            for part, old in zip(parts, kept, strict=True):
                part.method.multiplier = old
            return np.concatenate([np.einsum("pd,pd->p", a, n) for a, n in zip(new, normals, strict=True)])

        first, columns, size = updated(), [], 1e4
        for part, normal in zip(parts, normals, strict=True):
            for k in np.flatnonzero(part.pairing.paired):
                part.method.multiplier = part.method.multiplier.copy()
                part.method.multiplier[k] += size * normal[k]
                columns.append((updated() - first) / size)
        paired = np.concatenate([part.pairing.paired for part in parts])
        return np.linalg.eigvals(np.array(columns)[:, paired])

    values = run(case, measure)[1]
    assert len(values) > 20 and np.abs(values).max() < 0.25


# -- how fast multipliers settle -----------------------------


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("cell, order", [("quadrilateral", 1), ("triangle", 2), ("tetrahedron", 2)])
def test_flat_surfaces(tmp_path, cell, order, friction):
    """Of unlike meshes and widths: 25 to more than 30 updates with multipliers of each surface alone."""
    dim, n = (2, (4, 6)) if cell != "tetrahedron" else (3, (2, 3))
    path = two_blocks(tmp_path / "b.msh", dim, *n, cell, widths=(1.0, 0.6))
    case = dragged(path, dim, order, friction=friction)
    case.petsc = {**case.petsc, **STAY}

    def measure(simulation):
        states = [half.state(simulation.stepper.u) for half in simulation.problem.contacts[0].pairs]
        return [2.0 * state["weight"] @ state["traction"] for state in states]

    records, (one, other) = run(case, measure)
    assert settled(records, 8) and records[-1]["imbalance"] < 1e-7
    # the two surfaces say the same
    np.testing.assert_allclose(other, -one, rtol=0.0, atol=0.03 * np.linalg.norm(one))


@pytest.mark.slow
def test_a_disk_on_a_block(tmp_path):
    """Curved cells of degree 2: with multipliers of each surface alone load steps were cut back, in vain."""
    path = disk_on_block(tmp_path / "d.msh", h=0.08, order=2)
    peaks = []
    for unbiased in (True, False):
        case = disk_scene(path, 0.0, order=2)
        (contact,) = case.contacts
        contact.formulation, contact.unbiased, contact.friction = AUGMENTED, unbiased, 0.3
        case.steps, case.petsc = Steps(count=2), {}
        records, _ = run(case)
        assert settled(records, 10)
        contact = records[-1]["contacts"]["disk-block"]
        assert contact["force"][1] == pytest.approx(-0.1 * np.pi * 0.25**2, rel=1e-4)
        assert records[-1]["imbalance"] < 1e-7
        peaks.append(contact["max_pressure"])
    assert peaks[0] == pytest.approx(peaks[1], rel=0.1)


@pytest.mark.slow
def test_the_pressure_of_both_surfaces_is_hertz(tmp_path):
    """As near as with a source and a target: the two surfaces do not drift apart (error of 47 %)."""
    mesh, found = generate(compare.CASE, tmp_path / "c.msh", compare.CASE.half_width / 5, 1), []
    for unbiased in (True, False):
        case = compare.make_scene(mesh, "augmented", 1.0, 1)
        case.contacts[0].unbiased = unbiased
        records, points = run(case, contact_points)
        assert settled(records, 6)
        found.append(compare.measure(points, records[-1]))
    assert found[0]["error"] < 1.1 * found[1]["error"] < 0.15
    assert found[0]["oscillation"] < 1.1 * found[1]["oscillation"] and found[0]["balance"] < 1e-7


@pytest.mark.parametrize("order", [1, 2])
def test_self_contact(tmp_path, order):
    """A ring whose lips meet, with friction: 30 updates with multipliers of each lip alone."""
    path = c_strip(tmp_path / "strip.msh", (3, 24), 1, "quadrilateral", gap=2.0)
    case = strip(path, False, "skin", formulation=AUGMENTED)
    case.mesh.order = order
    records, _ = run(case)
    assert settled(records, 8)
    assert records[-1]["contacts"]["lips"]["force"][1] == pytest.approx(1.2 * 10.5, rel=2e-3)


@pytest.mark.parallel
@pytest.mark.parametrize("whole, friction", [(False, 0.3), (True, 0.0)], ids=["pair", "all surfaces"])
def test_the_same_on_any_ranks(shared_tmp, whole, friction):
    path, results = make_mesh(two_blocks, shared_tmp / "b.msh", 2, 4, 5, "quadrilateral", widths=(1.0, 0.6)), []
    names = {"all": True} if whole else {"source": "upper_bottom", "target": "lower_top", "unbiased": True}
    for comm in (WORLD, SELF):
        contact = Contact(formulation=AUGMENTED, friction=friction, name="pair", **names)
        records, _ = run(blocks(path, [contact], order=2), comm=comm)
        assert settled(records, 8)
        results.append((records[-1]["uzawa"], records[-1]["contacts"]["pair"]))
        WORLD.Barrier()
    (one, a), (other, b) = results
    assert one["updates"] == other["updates"] and one["change"] == pytest.approx(other["change"], rel=1e-3)
    assert a["max_pressure"] == pytest.approx(b["max_pressure"], rel=1e-6)
    np.testing.assert_allclose(a["force"], b["force"], atol=1e-6 * np.abs(b["force"]).max())


# -- a load step that a shorter one would not help ------------


def test_rate():
    assert rate([1.0, 0.5, 0.25, 0.125]) is None
    assert rate([1.0, 0.9, 0.45, 0.225, 0.1125, 0.05625]) == pytest.approx(0.5)
    assert rate([1.0, 0.5, 0.25, 0.25, 0.125, 0.0625]) is None
    assert rate([0.01, 0.0102, 0.0104, 0.0106, 0.0109]) == pytest.approx(1.0, abs=0.03)
    assert rate([1.0, 0.0, 0.0, 0.0, 0.0]) is None


@pytest.fixture
def slowly(monkeypatch):
    """A small gamma does not grow."""
    monkeypatch.setattr(AugmentedLagrangian, "stiffen", lambda self: None)


def slow(folder, updates, gamma0=0.1):
    """A block pressed on a plane with a small gamma, in four load steps."""
    path, d = made(folder, "quadrilateral")
    case = pressed(path, d, AUGMENTED, petsc={"contact_uzawa_max_it": str(updates)}, gamma0=gamma0)
    case.steps = Steps(count=4)
    return case


def end(case):
    """Whether a run came to its end, its load steps, what was cut. Collective."""
    watch, simulation = Watch(), Simulation(case)
    try:
        return simulation.run(observers=[watch]), watch.records, watch.cuts
    finally:
        simulation.close()


@pytest.mark.parallel
def test_a_known_rate_ends_the_run_without_a_cut(shared_tmp, slowly, capsys):
    """One line with the pair, what is left, and a number of updates that is enough."""
    converged, records, cuts = end(slow(shared_tmp, 10))
    assert not converged and not records and not cuts
    if WORLD.rank == 0:
        (line,) = capsys.readouterr().err.splitlines()
        assert "contact floor" in line and "0 to 0.25" in line
        needed = int(re.search(r"-contact_uzawa_max_it (\d+)", line)[1])
    else:
        needed = None
    needed = WORLD.bcast(needed)
    converged, records, cuts = end(slow(shared_tmp, needed))
    assert converged and not cuts
    assert 0.5 * needed < records[0]["uzawa"]["updates"] <= needed and records[0]["uzawa"]["change"] <= 1e-4


def test_one_cut_tells_where_the_rate_is_not_known(tmp_path, slowly, capsys):
    """After two updates nothing is known; the half of the load step ends like the whole."""
    converged, records, cuts = end(slow(tmp_path, 2))
    assert not converged and not records and len(cuts) == 1
    text = capsys.readouterr().err
    assert "0 to 0.125" in text and "contact floor" in text and "multipliers" in text


def test_multipliers_of_no_effect_ask_for_another_gamma(tmp_path, slowly, capsys):
    converged, _, cuts = end(slow(tmp_path, 6, gamma0=1e-6))
    assert not converged and not cuts
    text = capsys.readouterr().err
    assert "a gamma0 near 1" in text and "max_it" not in text


def test_a_run_that_ends_with_multipliers_that_creep_is_warned_of(tmp_path, slowly, monkeypatch):
    case = slow(tmp_path, 6)
    monkeypatch.setattr("pcontact.stepping.load_step.CREEP", np.inf)
    with running(case, tmp_path / "out") as (simulation, converged):
        assert converged
    assert (tmp_path / "out" / "report.json").read_text().count("contact floor: multipliers still change by") >= 1
