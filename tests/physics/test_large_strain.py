"""The driver of large strain has what closed forms say, on meshes as coarse as they allow."""

from types import SimpleNamespace

import pytest

from drivers.cases._known import off
from drivers.cases.large_strain import BOUNDS, MAKERS


@pytest.mark.slow
@pytest.mark.parametrize("case, n", [("uniaxial", None), ("shear", None), ("sphere", 16)])
def test_closed_forms(tmp_path, case, n):
    """Bars of three laws up to stretches of 0.5 and 3, shear up to 5, a hollow sphere of rubber; quadratic tails."""
    args = SimpleNamespace(o=tmp_path, tiny=False, n=n, fields=False)
    rows, records, converged, norms = MAKERS[case](args, {"snes_rtol": "1e-10"})
    # the polygon of the sphere has four times the error of the driver's
    assert converged and off(rows) < (4.0 if case == "sphere" else 1.0) * BOUNDS[case]
    assert sum(record["cutbacks"] for record in records) == 0
    if case != "shear":
        # the last one is as small as 1e3 times the square of the one before, or rounding errors
        assert norms[-1] / norms[0] < max(1e3 * (norms[-2] / norms[0]) ** 2, 1e-9)
