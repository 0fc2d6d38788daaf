"""The spring that closes: stiffness by the formula, force against travel, penetration, ranks."""

from argparse import Namespace

import pytest

from drivers._common import make_mesh, running
from drivers.spring import History, closing_travel, left_inside, scene, textbook
from meshes import spring

ARGS = Namespace(
    coils=2.5, radius=3.0, top=None, wire=1.0, pitch=1.4, order=1, friction=0.0, yield_stress=0.0, hardening=0.0,
    steps=2,
)  # fmt: skip


def pressed(path, part, **change):
    """Rows of the load steps and what is left inside. Collective."""
    args = Namespace(**{**vars(ARGS), **change})
    travel = part * closing_travel(args)
    history = History(travel, args.wire)
    with running(scene(path, args, travel), None, [history]) as (simulation, converged):
        assert converged
        return history.rows, left_inside(simulation)


def mesh(folder, top=None):
    said = {"wire": 1.0, "diameter": 6.0, "coils": 2.5, "pitch": 1.4, "ends": "ground", "along": 2.0, "top": top}
    return make_mesh(spring, folder / f"s{top}.msh", 0.5, **said)


def test_formula_of_a_cone():
    """The formula's integral: narrow coils are stiff."""
    straight = textbook(ARGS)
    assert straight == pytest.approx(206e3 / 2.6 / (8.0 * 6.0**3 * 0.5))
    cone = textbook(Namespace(**{**vars(ARGS), "top": 2.0}))
    assert straight < cone < straight * 1.5**3
    assert textbook(ARGS, 0.0) == pytest.approx(straight / 5.0)


@pytest.mark.parallel
def test_coils_close(shared_tmp):
    """Soft at first, forces in balance, nothing left inside."""
    rows, left = pressed(mesh(shared_tmp), 0.9)
    assert rows[-1]["force"] > 2.2 * rows[0]["force"] > 0.0
    assert max(row["imbalance"] for row in rows) < 1e-6
    assert sum(row["cutbacks"] for row in rows) == 0
    assert left < 1e-3 and rows[-1]["area"] > 0.0


def test_a_cone_is_stiffer(shared_tmp):
    """Of a narrow end, before coils touch."""
    (row,), _ = pressed(mesh(shared_tmp), 0.1, steps=1)
    (cone,), _ = pressed(mesh(shared_tmp, 4.0), 0.1, steps=1, top=2.0)
    assert cone["force"] > 1.1 * row["force"]
