"""The spring that closes: stiffness by the formula, force against travel, penetration, ranks."""

from argparse import Namespace

import numpy as np
import pytest

from drivers._common import running
from drivers.cases import spring
from drivers.cases.spring import History, closing_travel, ground, left_inside, scene, sides, textbook

pytestmark = pytest.mark.slow
ARGS = Namespace(
    coils=2.5, radius=3.0, top=None, wire=1.0, pitch=1.4, order=1, friction=0.0, yield_stress=0.0, hardening=0.0,
    steps=6, h=0.5, along=2.0,
)  # fmt: skip


def pressed(path, part, **change):
    """Rows of the load steps and what is left inside. Collective."""
    args = Namespace(**{**vars(ARGS), **change})
    travel = part * closing_travel(args)
    history = History(travel, args.wire, args.steps)
    with running(scene(path, args, travel), None, [history]) as (simulation, converged):
        assert converged
        return history.rows, left_inside(simulation)


def mesh(folder, top=None):
    return spring.mesh(folder / f"s{top}.msh", Namespace(**{**vars(ARGS), "top": top}))


def test_formula_of_a_cone():
    """The formula's integral: narrow coils are stiff."""
    straight = textbook(ARGS)
    assert straight == pytest.approx(206e3 / 2.6 / (8.0 * 6.0**3 * 0.5))
    cone = textbook(Namespace(**{**vars(ARGS), "top": 2.0}))
    assert straight < cone < straight * 1.5**3
    assert textbook(ARGS, 0.0) == pytest.approx(straight / 5.0)


def test_closing_travel():
    """By hand: 4 coils, ground ends held at a half turn and 3 turns above; flats of 15 degrees. A cone goes on."""
    args = Namespace(**{**vars(ARGS), "coils": 4.0, "h": 0.26})
    assert sides(args) == 3
    assert ground(args) == pytest.approx(0.65 / 1.1)
    # height 5 - 0.3, centres at -0.15 + 0.55 from both plates, three wires between them
    assert closing_travel(args) == pytest.approx(4.7 - 0.8 - 3.0 * np.cos(np.pi / 12.0))
    round_wire = Namespace(**{**vars(args), "order": 2})
    assert closing_travel(round_wire) == pytest.approx(0.9)
    cone = Namespace(**{**vars(round_wire), "top": 2.0})
    assert closing_travel(cone) == pytest.approx(0.9 + 3.0 * (1.0 - 0.9375**0.5))


@pytest.mark.parametrize(("h", "flats"), [(0.5, 3), (0.26, 3), (0.15, 5), (0.11, 7)])
def test_flats_meet(h, flats):
    """An odd number on a quarter, whatever the element size."""
    assert sides(Namespace(wire=1.0, h=h)) == flats


@pytest.mark.parallel(2, 3)
def test_coils_close(shared_tmp):
    """A line at first, far steeper in the end, forces in balance, nothing left inside."""
    rows, left = pressed(mesh(shared_tmp), 0.9)
    slope = np.diff([row["force"] for row in rows]) / np.diff([row["travel"] for row in rows])
    assert slope[-1] > 5.0 * rows[0]["force"] / rows[0]["travel"] > 0.0
    assert max(row["imbalance"] for row in rows) < 1e-6
    assert sum(row["cutbacks"] for row in rows) == 0
    assert max(left, *(row["penetration"] for row in rows)) < 1e-3
    assert rows[-1]["area"] > 0.0


def test_a_cone_is_stiffer(shared_tmp):
    """Of a narrow end, before coils touch."""
    (row,), _ = pressed(mesh(shared_tmp), 0.1, steps=1)
    (cone,), _ = pressed(mesh(shared_tmp, 2.0), 0.1, steps=1, top=2.0)
    assert cone["force"] > 1.1 * row["force"]
