"""The impacts of the manual on coarse meshes: near the known answers, and the same numbers on any ranks."""

from types import SimpleNamespace

import numpy as np
import pytest

from drivers.cases import impact
from drivers.cases._known import off

# of tiny runs, on one rank: how far they are from what is known, and the first of their numbers
CASES = {
    "bar": (0.03, [1.0213055716, 301.43614]),
    "string": (0.05, [0.522128654, 0.129947517]),
    "held": (0.035, [3972266232.4, 9.9137931e-05, 3136.50935]),
    "hertz": (0.06, [2291.421610, 4.9628e-05, 0.0326393622, 993.5681319]),
    "elastic": (0.003, [239.810402, 240.2217257]),
    # an eighth of the way
    "taylor": (np.inf, [30.1475421, 5.33155725]),
    "slider": (0.06, [0.175459185, 0.499893594]),
}


@pytest.mark.slow
@pytest.mark.parallel(1, 3)
@pytest.mark.parametrize("case", CASES)
def test_on_any_ranks(shared_tmp, case):
    bound, numbers = CASES[case]
    args = SimpleNamespace(tiny=True, n=None, o=shared_tmp, fields=False)
    found = impact.MAKERS[case](args, {"snes_rtol": "1e-10"})
    assert found.converged and off([row for row in found.rows if row[1]]) < bound
    assert [row[2] for row in found.rows[: len(numbers)]] == pytest.approx(numbers, rel=1e-6)
    # plastic flow in long steps is what Taylor's bar lacks
    assert abs(found.records[-1]["energy"]["defect"]) < (0.01 if case == "taylor" else 1e-9)
