"""Self contact: what is no partner, a C-shaped strip against its two halves, tangents, ranks."""

import numpy as np
import pytest

from drivers._common import make_mesh, running
from drivers.studies.swapped import scene, solved
from meshes import c_strip, two_blocks
from pcontact.contact.formulation.methods import contacts_of_halves, halved
from pcontact.contact.pair import contact_pair
from pcontact.contact.search.partners import find_partners
from pcontact.contact.search.projection import QueryPoints
from pcontact.contact.search.self_contact import self_surface
from pcontact.contact.surface.sides import source_surface, target_surface
from pcontact.mesh.read import read_mesh
from pcontact.mesh.topology import components
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact, Region
from pcontact.simulation import Simulation
from pcontact.space.space import Space
from tests.support.dealt import distribute
from tests.support.pairs import CONSTANTS, by_key, residual_of
from tests.support.self_contact import ALONE, annulus, skin_of, strip
from tests.support.small import DIMENSION, SELF, Together, block_file, blocks_file, dense_item, elastic_solid, vector_of

WORLD = MPI.COMM_WORLD
SEARCHES = ["closest_point", "ray_tracing"]


def found(space, search, radius=10.0, moved=None):
    """The source and its partners on itself, the bodies moved by (n_local, d)."""
    source = source_surface(space, "skin", [CONSTANTS] * 2, 3)
    target = self_surface(space, target_surface(space, "skin"), source)
    nodal = np.zeros((space.n_local, space.dim)) if moved is None else moved
    x = source.x + np.einsum("pa,pad->pd", source.shape, nodal[source.cells[source.facet]])
    return source, find_partners(space, target, nodal, QueryPoints(x, source.normal, radius), search)


# -- what is no partner -------------------------------


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("cell", list(DIMENSION))
@pytest.mark.parametrize("shape", ["plate", "block", "wedge", "edge of a knife"])
def test_a_body_alone_finds_no_partner(tmp_path, shape, cell, search):
    """Neither across its edges nor through its material, however thin; nor when it is bent or squeezed."""
    space = skin_of(SELF, block_file(tmp_path / "b.msh", cell, 4), ALONE[shape])
    x = space.points
    bent, squeezed = np.zeros_like(x), np.zeros_like(x)
    bent[:, -1] = 0.2 * x[:, 0] ** 2
    squeezed[:, -1] = -0.3 * x[:, -1]
    for moved in (None, bent, squeezed):
        source, partners = found(space, search, moved=moved)
        assert np.all(partners.ids < 0), source.x[partners.ids >= 0]


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("shape", ["shell", "thick shell"])
@pytest.mark.parametrize("cell, degree", [("triangle", 1), ("quadrilateral", 2), ("hexahedron", 1)])
def test_a_bent_body_sees_itself_across_the_hollow_alone(tmp_path, shape, cell, degree, search):
    """Partners of an open ring: from the hollow side to the hollow side, with a positive gap."""
    path = block_file(tmp_path / "b.msh", cell, [24, *[2] * (DIMENSION[cell] - 1)])
    space = skin_of(SELF, path, ALONE[shape], degree)
    source, partners = found(space, search)
    paired, r = partners.ids >= 0, np.hypot(source.x[:, 0], source.x[:, -1])
    assert np.all(partners.gap[paired] > 0.0)
    outward = (source.normal[:, 0] * source.x[:, 0] + source.normal[:, -1] * source.x[:, -1]) / r
    assert np.mean(paired[outward < -0.9]) > 0.3 and not np.any(paired[outward > 0.9])


@pytest.mark.parametrize("search", SEARCHES)
def test_a_narrow_slot_in_thin_sheets(tmp_path, search):
    """A hairpin: the slot is five times as wide as the sheets are thick, the way through the material is shorter."""
    path = block_file(tmp_path / "b.msh", "quadrilateral", [40, 2])

    def hairpin(x):
        """A straight leg, half a turn, a straight leg."""
        s, out, radius = 4.0 * x[:, 0], 0.05 * x[:, 1], 0.125
        arc = np.pi * radius
        leg = 0.5 * (4.0 - arc)
        angle = np.clip((s - leg) / radius, 0.0, np.pi)
        r = radius + out
        along = np.where(s < leg, s, leg) - np.where(s > leg + arc, s - leg - arc, 0.0)
        return np.column_stack([along + r * np.sin(angle), r * np.cos(angle)])[:, [0, 1]] * [1.0, 1.0]

    def turned(x):
        y = hairpin(x)
        return y if _area(y, x) > 0 else y * [1.0, -1.0]

    space = skin_of(SELF, path, turned)
    source, partners = found(space, search, radius=1.0)
    inner = (np.abs(np.abs(source.x[:, 1]) - 0.125) < 1e-9) & (source.x[:, 0] > 0.1) & (source.x[:, 0] < 1.7)
    assert inner.sum() > 20
    np.testing.assert_allclose(partners.gap[inner], 0.25, rtol=1e-9)
    outer = (np.abs(np.abs(source.x[:, 1]) - 0.175) < 1e-9) & (source.x[:, 0] < 1.7)
    assert outer.sum() > 20 and np.all(partners.ids[outer] < 0)
    # pressed through each other by more than a sheet is thick, partners are the same
    moved = np.zeros_like(space.points)
    moved[:, 1] = -np.sign(space.points[:, 1]) * 0.16 * (space.points[:, 0] < 1.85)
    _, crossed = found(space, search, 1.0, moved)
    np.testing.assert_allclose(crossed.gap[inner], 0.25 - 0.32, rtol=1e-6)


def _area(y, x):
    """Sign of the map's determinant."""
    a = np.argmin(np.abs(x - [0.0, 0.0]).sum(axis=1))
    b = np.argmin(np.abs(x - [0.025, 0.0]).sum(axis=1))
    c = np.argmin(np.abs(x - [0.0, 0.5]).sum(axis=1))
    return np.linalg.det(np.array([y[b] - y[a], y[c] - y[a]]))


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_bodies_of_one_group_are_partners(tmp_path, cell):
    """Two boxes that overlap: the points between them have partners on the other box, no other point has one."""
    path = blocks_file(tmp_path / "b.msh", cell, 2, 3, gap=-0.05)
    space = skin_of(SELF, path, regions=("lower", "upper"))
    source, partners = found(space, "closest_point", 0.3)
    upward = source.normal[:, -1] * np.where(source.components[source.facet] == 0, 1.0, -1.0)
    between = (np.abs(source.x[:, -1] - 1.0) < 0.06) & (upward > 0.5)
    assert np.all((partners.ids >= 0) == between)
    np.testing.assert_allclose(partners.gap[between], -0.05, rtol=1e-9)


# -- a strip and its halves ---------------------------


class Last(Observer):
    """Observer: the last record."""

    def step(self, step, u, record):
        self.record = record


def closed(folder, split=False, n=(3, 24), **said):
    """Record of the last load step. Collective."""
    cell = said.pop("cell", "quadrilateral")
    path = make_mesh(c_strip, folder / f"strip{int(split)}.msh", n, 1, cell, gap=2.0, split=split)
    watch = Last()
    with running(strip(path, split, **said), None, [watch]) as (simulation, converged):
        assert converged
        (contact,) = simulation.problem.contacts
        assert contact.weight == 0.5 and len(contact.pairs) == 1 + split
    return watch.record


def probes(record):
    return np.array([record["probes"][name]["mean"] for name in ("lip_upper", "lip_lower")])


@pytest.mark.parallel
@pytest.mark.parametrize("cell, search, traction", [
    ("quadrilateral", "closest_point", "both"), ("quadrilateral", "ray_tracing", "both"),
    ("quadrilateral", "closest_point", "source"), ("quadrilateral", "ray_tracing", "source"),
    pytest.param("triangle", "closest_point", "source", marks=pytest.mark.slow),
])  # fmt: skip
def test_lips_of_one_body_are_those_of_two(shared_tmp, cell, search, traction):
    """Same points, same partners, same tractions: the same numbers; hoop force of a closed ring."""
    said = {"search": search, "friction": 0.3, "cell": cell, "n": (6, 48), "traction": traction}
    one, two = (closed(shared_tmp, split, **said) for split in (False, True))
    np.testing.assert_allclose(probes(one), probes(two), rtol=0.0, atol=1e-6)
    a, b = one["contacts"]["lips"], two["contacts"]["lips"]
    assert a["area"] == pytest.approx(b["area"], rel=1e-9) and a["area"] == pytest.approx(1.0, rel=1e-6)
    assert a["force"][1] == pytest.approx(-b["force"][1], rel=1e-6)
    assert a["force"][1] == pytest.approx(1.2 * 10.5, rel=1e-3)


@pytest.mark.parallel
@pytest.mark.parametrize("search", SEARCHES)
def test_the_whole_skin_closes_at_the_lips(shared_tmp, search):
    """The lips find each other among all faces of the strip, ten times thinner than wide."""
    skin, lips = (closed(shared_tmp, group=group, search=search, n=(6, 48)) for group in ("skin", "lips"))
    np.testing.assert_allclose(probes(skin), probes(lips), rtol=0.0, atol=3e-3)
    a, b = skin["contacts"]["lips"], lips["contacts"]["lips"]
    assert a["area"] == pytest.approx(b["area"], rel=1e-6)
    assert a["force"][1] == pytest.approx(b["force"][1], rel=1e-3)


# -- tangent, ranks -----------------------------------


@pytest.mark.parametrize("traction", ["both", "source"])
@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
def test_tangent(tmp_path, theta, friction, traction):
    """Of lips that overlap in part: the derivative, symmetric for theta = 1; forces balance."""
    path = c_strip(tmp_path / "strip.msh", (2, 8), gap=2.0)
    raw = read_mesh(path)
    mesh = distribute(SELF, raw, False, np.zeros(len(raw.blocks[0].nodes), dtype=np.int64), components(raw))
    mesh.component_names = ["strip"]
    space = Space(mesh, 1)
    said = {"search": "closest_point", "gamma0": 1.0, "friction": friction, "alpha": 0.7, "traction": traction}
    contact = Contact("skin", "skin", theta=theta, **said)
    (one,) = contacts_of_halves(contact, traction == "both")
    source = source_surface(space, "skin", [CONSTANTS])
    target = self_surface(space, target_surface(space, "skin"), source)
    bulk = elastic_solid(space, [CONSTANTS])
    item = Together(contact, [contact_pair(space, one, halved(source), target, 1.0, bulk=bulk)])
    x = space.points[space.owned_local]
    u = np.zeros_like(x)
    u[:, 1] = -0.2 * np.sign(x[:, 1]) * (x[:, 0] > 8.0) * (1.0 + 0.3 * (x[:, 0] - 10.0))
    u[:, 0] = -0.1 * u[:, 1]
    item.detect(vector_of(space, 0.9 * u), 1.0)
    assert 0 < item.summary(vector_of(space, u))["slip"] < len(source.facet)
    assert item.pairs[0].terms.wide(item.pairs[0].pairing).any() == (traction == "both")
    v = 1e-7 * np.random.default_rng(2).normal(size=x.shape)
    k = dense_item(item, vector_of(space, u))
    change = residual_of(item, u + v) - residual_of(item, u - v)
    # piecewise linear: no point changes its status on the way
    np.testing.assert_allclose(change / 1e-7, 2.0 * k @ v.ravel() / 1e-7, atol=1e-7 * np.abs(k).max())
    if theta == 1.0 and not friction:
        np.testing.assert_allclose(k, k.T, atol=1e-13 * np.abs(k).max())
    force = residual_of(item, u).reshape(-1, 2)
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-12 * np.abs(force).max())


@pytest.mark.parallel
@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_partners_do_not_depend_on_the_ranks(shared_tmp, cell, search):
    """Of an open ring with bumps, whose facets are held at edges in many places."""
    path = shared_tmp / "b.msh"
    if WORLD.rank == 0:
        block_file(path, cell, [20, *[2] * (DIMENSION[cell] - 1)])
    WORLD.Barrier()
    tables = []
    for comm in (WORLD, SELF):
        space = skin_of(comm, path, lambda x: annulus(x, 5.0, 1.0 + 0.1 * np.sin(40.0 * x[:, 0]), 1.4))
        moved = 0.02 * np.sin(9.0 * space.points[:, ::-1])
        source, partners = found(space, search, 4.0, moved)
        gap = np.where(partners.ids >= 0, partners.gap, 0.0)
        columns = np.column_stack([source.point_keys(), partners.ids, gap, partners.y * (partners.ids >= 0)[:, None]])
        parts = comm.allgather(columns)
        table = np.concatenate(parts)
        tables.append(table[np.argsort(table[:, 0])])
    np.testing.assert_array_equal(tables[0][:, :2], tables[1][:, :2])
    np.testing.assert_allclose(tables[0], tables[1], atol=1e-12)
    assert 0.1 < np.mean(tables[1][:, 1] >= 0) < 0.9


@pytest.mark.parallel
def test_displacements_do_not_depend_on_the_ranks(shared_tmp):
    path = make_mesh(c_strip, shared_tmp / "strip.msh", (3, 24), 1, "quadrilateral", gap=2.0)
    results = []
    for comm in (WORLD, SELF):
        simulation = Simulation(strip(path, False, "skin"), comm)
        try:
            assert simulation.run()
            results.append(by_key(simulation.problem.space, simulation.stepper.u.getArray().reshape(-1, 2)))
        finally:
            simulation.close()
        WORLD.Barrier()
    np.testing.assert_allclose(results[0], results[1], atol=1e-7)


@pytest.mark.parametrize("strain", ["small", "finite"])
def test_a_soft_and_a_stiff_surface_of_one_group(tmp_path, strain):
    """The pressure is that of the two as surfaces of their own, which the traction of the stiff side does not know."""
    path, pressures = make_mesh(two_blocks, tmp_path / "b.msh", 2, 8, 16, heights=(1.0, 0.3)), {}
    for alone in (False, True):
        case = scene(path, 1, 1e3, 0.5, "both", strain)
        if alone:
            case.regions = [Region("faces", where="y == 1")]
            case.contacts = [Contact("faces", "faces", name="c", friction=0.5, self_contact=True)]
        place, pressure, _, _ = solved(case)
        order = np.lexsort([pressure, np.round(place, 9)])
        pressures[alone] = pressure[order]
    np.testing.assert_allclose(pressures[True], pressures[False], rtol=1e-6)
