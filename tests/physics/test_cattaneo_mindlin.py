"""Cattaneo and Mindlin: stick zone, traction at its edge, and the shape of the profile, against the closed form."""

import numpy as np
import pytest

from drivers._common import parse
from drivers.cases.cattaneo_mindlin import (
    CASE,
    FORCE,
    OPEN,
    SHEAR,
    SLIP,
    STICK,
    check,
    closed_form,
    edge_traction,
    facet_means,
    generate,
    make_options,
    measure,
    solve,
    stick_fit,
    variation,
)
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import agree
from pcontact.runtime.petsc import MPI

pytestmark = pytest.mark.slow
MU = 0.2
C, EDGE = 0.496511, 1.279571


def exact_points(shift=0.0, facets=150, per_facet=4):
    """The closed form as if it had been computed, its middle moved by `shift`."""
    ends = np.linspace(-1.0, 1.0, facets + 1)
    x = (ends[:-1, None] + np.diff(ends)[:, None] * (np.arange(per_facet) + 0.5) / per_facet).ravel()
    c, _, tangential = closed_form(x - shift, CASE.force, FORCE, MU)
    a, p0 = CASE.from_force(CASE.force)
    pressure = p0 * np.sqrt(np.maximum(1.0 - ((x - shift) / a) ** 2, 0.0))
    status = np.where(pressure == 0.0, OPEN, np.where(np.abs(x - shift) < c, STICK, SLIP))
    facet = np.repeat(np.arange(facets), per_facet)
    weight = np.full(len(x), 2.0 / len(x))
    return {"x": x, "tangential": tangential, "pressure": pressure, "status": status, "weight": weight, "facet": facet}


def test_closed_form():
    x = np.linspace(-0.7, 0.7, 20001)
    c, edge, profile = closed_form(x, 10.0, FORCE, MU)
    assert (c, edge) == pytest.approx((C, EDGE), rel=1e-6)
    assert c == pytest.approx(0.680778 * np.sqrt(1.0 - SHEAR / (MU * CASE.pressure)), rel=1e-6)
    assert profile.max() == pytest.approx(edge, rel=1e-3)
    assert np.sum(profile) * (x[1] - x[0]) == pytest.approx(FORCE, rel=1e-5)


@pytest.mark.parametrize("shift", [0.0, 0.03])
def test_measures_of_the_closed_form(shift):
    """What is measured on the closed form is the closed form."""
    points = exact_points(shift)
    assert stick_fit(points, MU) == pytest.approx((C, shift), rel=1e-5, abs=1e-9)
    if shift:
        return
    assert edge_traction(points, C, 0.680778) == pytest.approx(EDGE, rel=1e-5)
    found = measure(points, CASE.force, MU)
    assert found["c_area"] == pytest.approx(C, abs=2.0 / len(points["x"]))
    assert found["variation_points"] == pytest.approx(1.0, rel=1e-12)
    assert found["variation_facets"] == pytest.approx(1.0, abs=0.03)


def test_oscillation_is_seen():
    """A tenth of the peak, up and down from facet to facet of the stick zone, is far above the bound of 1.1."""
    points = exact_points()
    sticks = points["status"] == STICK
    points["tangential"] = points["tangential"] + np.where(sticks, 0.1 * EDGE * (-1.0) ** points["facet"], 0.0)
    assert measure(points, CASE.force, MU)["variation_facets"] > 3.0
    assert variation(np.array([0.0, 1.0, 0.5, 1.0])) == 3.0


def test_facet_means():
    points = exact_points()
    turned = {key: value[::-1] for key, value in points.items()}
    for found in (facet_means(points), facet_means(turned)):
        assert np.allclose(found["x"], points["x"].reshape(-1, 4).mean(axis=1), rtol=0.0, atol=1e-14)
        assert np.allclose(found["pressure"], points["pressure"].reshape(-1, 4).mean(axis=1), rtol=1e-13)


@pytest.mark.parametrize("words, said", [(["--mu", "0.09"], "--mu"), (["--press", "0"], "--press")])
def test_wrong_options(words, said):
    with pytest.raises(InputError, match=said):
        check(parse(make_options(), words))


@pytest.mark.parametrize("theta", [1.0, pytest.param(0.0, marks=pytest.mark.parallel(2, 3)), -1.0])
def test_cattaneo_mindlin(shared_tmp, theta):
    """22 facets in the contact half width, degree 1."""
    args = parse(make_options(), ["--steps", "2"])
    check(args)
    result, points, converged = solve(generate(shared_tmp / "mesh.msh", args), args, theta)
    assert converged
    assert all(step["cutbacks"] == 0 for step in result["steps"])
    assert result["balance"] < 1e-8
    assert abs(result["steps"][-1]["reaction"][0]) < 1e-8 * FORCE
    assert result["load"] == pytest.approx(CASE.force, rel=1e-3)
    # bodies of equal material: the shear leaves the pressure alone
    assert result["load"] == pytest.approx(-result["steps"][args.press - 1]["reaction"][1], rel=1e-4)
    for key, given, within in (("a", 0.680778, 0.004), ("p0", 9.351351, 0.004), ("c", C, 0.02)):
        reference = result[f"{key}_exact" if key == "c" else f"{key}_hertz"]
        assert result[f"{key}_fit"] == pytest.approx(reference, rel=within)
        assert result[f"{key}_fit"] == pytest.approx(given, rel=within)
    assert abs(result["c_area"] - result["c_exact"]) < args.h
    assert result["edge"] == pytest.approx(result["edge_exact"], rel=0.03)
    assert result["edge"] == pytest.approx(EDGE, rel=0.03)
    assert result["variation_facets"] < 1.1
    message = None
    if points is not None:
        excess = np.abs(points["tangential"]) - MU * points["pressure"]
        message = None if excess.max() < 1e-9 else f"{excess.max()} above the bound"
    agree(MPI.COMM_WORLD, message)
