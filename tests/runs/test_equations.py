"""Linear equations between components, and groups that move as their partners do, turned: known answers, ranks."""

import numpy as np
import pytest

from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.describe import describe
from pcontact.scene.model import (
    Body,
    Displacement,
    Equation,
    Load,
    Material,
    MeshSpec,
    Output,
    Periodic,
    Scene,
)
from pcontact.simulation import Simulation
from pcontact.space.constraints import eliminate
from tests.support.bad_input import mesh_text

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel
E = 100.0
INNER, OUTER, SECTOR = 1.0, 2.0, 40.0


def grid(path, place, size, points):
    """Quadrilaterals between the places of (0..1, 0..1), with their sides, and groups of single nodes."""
    across, along = size
    nodes = [place(i / across, j / along) for j in range(along + 1) for i in range(across + 1)]

    def at(i, j):
        return 1 + i + (across + 1) * j

    cells = [(3, 1, (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)))
             for j in range(along) for i in range(across)]  # fmt: skip
    for group, j in ((2, 0), (3, along)):
        cells += [(1, group, (at(i, j), at(i + 1, j))) for i in range(across)]
    for group, i in ((4, 0), (5, across)):
        cells += [(1, group, (at(i, j), at(i, j + 1))) for j in range(along)]
    groups = {(2, 1): "body", (1, 2): "first", (1, 3): "last", (1, 4): "low", (1, 5): "high"}
    for number, (name, i, j) in enumerate(points, 6):
        cells.append((15, number, (at(i, j),)))
        groups[0, number] = name
    path.write_text(mesh_text(nodes, cells, groups))


@pytest.fixture
def mesh(shared_tmp):
    paths = {name: shared_tmp / f"{name}.msh" for name in ("square", "sector")}
    if WORLD.rank == 0:
        corners = [(f"top_{i}", i, 2) for i in range(4)] + [("foot", 0, 0)]
        grid(paths["square"], lambda s, t: (3.0 * s, 2.0 * t), (3, 2), corners)

        def ring(s, t):
            radius, angle = INNER + (OUTER - INNER) * s, np.radians(SECTOR * (t - 0.3))
            return radius * np.cos(angle), radius * np.sin(angle)

        grid(paths["sector"], ring, (8, 10), [("held", 8, 3)])
    WORLD.Barrier()
    return paths


def solved(path, comm=SELF, **more):
    scene = Scene(
        MeshSpec(path), {"m": Material(E, more.pop("nu", 0.0))}, [Body("body", "m")], output=Output(fields=False),
        petsc={"snes_rtol": "1e-12", "ksp_rtol": "1e-13"}, **more,
    )  # fmt: skip
    simulation = Simulation(scene, comm)
    assert simulation.run(keep=True)
    simulation.close()
    space = simulation.problem.space
    x = space.points[space.owned_local]
    return simulation, x, simulation.stepper.u.getArray(readonly=True).reshape(x.shape)


def test_what_follows_satisfies_all_equations():
    """Random equations, some of them dependent: for any values of the others, every one of them holds."""
    random = np.random.default_rng(3)
    places = [random.choice(30, 4, replace=False).tolist() for _ in range(12)]
    rows = [dict(zip(place, random.normal(size=4), strict=True)) for place in places]
    rows += [{k: rows[0].get(k, 0.0) - 2.0 * rows[1].get(k, 0.0) for k in rows[0].keys() | rows[1].keys()}]
    fixed = {3, 7, 11}
    ways, bound = eliminate(rows, fixed)
    assert len(ways) == 12 and bound == [] and not fixed & ways.keys()
    assert not any(way.keys() & ways.keys() for way in ways.values())
    values = random.normal(size=30)
    for component, way in ways.items():
        values[component] = sum(weight * values[k] for k, weight in way.items())
    assert max(abs(sum(c * values[k] for k, c in row.items())) for row in rows) < 1e-12


def test_equations_of_prescribed_components_are_named():
    assert eliminate([{1: 1.0, 2: -1.0}, {1: 2.0, 5: 1.0}], {1, 2}) == ({5: {1: -2.0}}, [0])


@parallel(1, 2, 3)
def test_a_top_that_moves_as_one(mesh):
    """A force at one of its nodes draws it evenly: u = F h / (E A)."""
    alike = [Equation([(f"top_{i}", "y", 1.0), ("top_0", "y", -1.0)]) for i in (1, 2, 3)]
    simulation, x, u = solved(
        mesh["square"], WORLD, equations=alike, loads=[Load("top_2", force=[0.0, 6.0])],
        displacements=[Displacement("first", ["free", 0]), Displacement("foot", [0, "free"])],
    )  # fmt: skip
    np.testing.assert_allclose(u[:, 1], 6.0 / (3.0 * E) * x[:, 1], rtol=1e-9, atol=1e-14)
    record = simulation.records.data()["steps"][-1]
    np.testing.assert_allclose(record["equations"]["force"], 0.0, atol=1e-10)
    assert record["imbalance"] < 1e-9 and "linear equations: 3" in describe(simulation.scene)[0]


@parallel(1, 2, 3)
def test_an_equation_with_a_prescribed_component(mesh):
    """One corner goes half as far as the other one is moved."""
    lever = [Equation([("top_0", "y", 2.0), ("top_3", "y", -1.0)])]
    _, x, u = solved(
        mesh["square"], WORLD, equations=lever, nu=0.3,
        displacements=[Displacement("first", [0, 0]), Displacement("top_3", ["free", 0.02])],
    )  # fmt: skip
    at = np.flatnonzero((x == [0.0, 2.0]).all(axis=1))
    assert WORLD.allreduce(float(u[at, 1].sum())) == pytest.approx(0.01, rel=1e-10)


@parallel(1, 2, 3)
def test_a_sector_of_a_ring(mesh):
    """Under pressure inside, with one side as the other one turned, it moves as a whole ring does (Lame)."""
    simulation, x, u = solved(
        mesh["sector"], WORLD, nu=0.3, loads=[Load("low", pressure=1.0)],
        displacements=[Displacement("held", ["free", 0])],
        periodic=[Periodic("last", "first", angle=SECTOR, point=[0, 0])],
    )  # fmt: skip
    assert simulation.floating == {}
    radius = np.linalg.norm(x, axis=1)
    radial, around = (u * x).sum(axis=1) / radius, (u[:, 1] * x[:, 0] - u[:, 0] * x[:, 1]) / radius
    factor = 1.3 / E * INNER**2 / (OUTER**2 - INNER**2)
    exact = factor * ((1.0 - 2.0 * 0.3) * radius + OUTER**2 / radius)
    np.testing.assert_allclose(radial, exact, rtol=6e-3)
    assert np.abs(around).max(initial=0.0) < 1e-9
    force = np.array(simulation.records.data()["steps"][-1]["equations"]["force"])
    # tension of the wall on both cuts, p r each, along the normals of the cuts
    ends = np.radians(SECTOR * np.array([-0.3, 0.7]))
    normals = np.array([[np.sin(ends[0]), -np.cos(ends[0])], [-np.sin(ends[1]), np.cos(ends[1])]])
    np.testing.assert_allclose(force, INNER * normals.sum(axis=0), rtol=5e-3)


def test_nodes_that_are_no_pairs(mesh):
    with pytest.raises(InputError, match=r"periodic\[0\] \(last\)\.partner: found 'first'.* allowed: nodes that are"):
        solved(mesh["sector"], periodic=[Periodic("last", "first", angle=SECTOR + 1.0, point=[0, 0])])


def test_groups_of_many_nodes(mesh):
    with pytest.raises(InputError, match=r"equations\[0\] \(last\)\.terms: found 'last', a group of 9 nodes"):
        solved(mesh["sector"], equations=[Equation([("last", "x", 1.0)])])
