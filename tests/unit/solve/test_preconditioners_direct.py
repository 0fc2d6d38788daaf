"""Small problems whose linear systems are factorised."""

from functools import partial

import numpy as np
import pytest

from drivers.studies._extreme_scenes import stack
from drivers.studies._extreme_shapes import pointed
from drivers.studies._named_scenes import HELD_BACK
from drivers.studies._robust_scenes import extreme, lid
from pcontact.runtime.petsc import MPI, has_package
from pcontact.simulation import Simulation


def solved(folder, make=HELD_BACK["sheared"].scene, **options):
    """Preconditioner, Krylov iterations of the load steps, and displacement of a scene: sheared blocks of 104 unknowns.
    """
    scene = make(folder)
    scene.petsc, counts = {**(scene.petsc or {}), **options}, []
    simulation = Simulation(scene)
    try:
        inner = simulation.newton.solve
        simulation.newton.solve = lambda *some: counts.append(inner(*some)) or counts[-1]
        assert simulation.run()
        u = simulation.stepper.u.getArray(readonly=True).copy()
        return simulation.newton.solver["preconditioner"], [one.krylov / max(one.newton, 1) for one in counts], u
    finally:
        simulation.free()


def test_below_a_number_of_unknowns(tmp_path):
    """One iteration for each linear system; the user's own preconditioner stays."""
    multigrid, many, u = solved(tmp_path)
    direct, few, same = solved(tmp_path, pc_direct_below="105")
    assert multigrid == "gamg" and direct == "lu"
    assert min(many) > 2.0 and max(few) <= 2.0
    assert same == pytest.approx(u, abs=1e-6 * np.abs(u).max())
    assert solved(tmp_path, pc_direct_below="104")[0] == "gamg"
    assert solved(tmp_path, pc_direct_below="105", pc_type="jacobi")[0] == "jacobi"


@pytest.mark.parallel(2)
def test_in_the_plane_on_any_number_of_ranks(shared_tmp):
    """With MUMPS; not where the user has chosen."""
    direct, few, _ = solved(shared_tmp, pc_direct_below="105")
    able = has_package("mumps") or MPI.COMM_WORLD.size == 1
    assert (direct, max(few) <= 2.0) == (("lu", True) if able else ("gamg", False))
    for kept in {"pc_direct_below": "104"}, {"pc_direct_below": "105", "pc_type": "gamg"}:
        assert solved(shared_tmp, **kept)[0] == "gamg"


@pytest.mark.parallel(2)
@pytest.mark.parametrize(
    "make", [lid, partial(extreme, build=pointed), partial(extreme, build=stack, youngs=(1e9, 1e3), pressure=10.0)],
    ids=["free in the end", "on a corner", "a stiff body on a soft one"],
)  # fmt: skip
def test_bodies_that_nothing_but_contact_holds(shared_tmp, make):
    """They touch nothing at first or in the end, or touch at a point: pivots of the size of their stabilisation."""
    u = solved(shared_tmp, make, snes_ksp_ew_rtol0="1e-8", snes_ksp_ew_rtolmax="1e-8")[2]
    direct, few, same = solved(shared_tmp, make, pc_direct_below="1000")
    able = has_package("mumps") or MPI.COMM_WORLD.size == 1
    assert direct == ("lu" if able else "gamg")
    if able:
        assert max(few) <= 3.0
        assert same == pytest.approx(u, abs=1e-6 * np.abs(u).max())
