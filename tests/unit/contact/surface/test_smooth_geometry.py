"""Straight facets of curved surfaces: the smooth surfaces they stand for, gaps, pressures, warnings."""

import json
from itertools import pairwise

import numpy as np
import pytest

from drivers._common import contact_points, make_mesh, running
from drivers.cases.rings import NU, PRESSURE, E, interface_pressure, measure, ring_scene
from drivers.studies.chords import shell_pressure, shell_scene
from meshes import rings
from meshes.blocks import two_blocks
from meshes.hertz import cylinder_on_block
from meshes.shells import shells
from pcontact.contact.surface.smooth_geometry import SmoothSurface, own_normals, smooth_surface
from pcontact.contact.surface.vertex_normals import Facets, corner_normals, curved_normals, facet_normals
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import shape
from pcontact.runtime import log
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene
from pcontact.simulation import Simulation
from tests.support.commands import execute
from tests.support.small import SELF, make_space

COMM = MPI.COMM_WORLD


def said():
    """Warnings of the run; those of options are about words of the process that runs the tests."""
    return [line for line in log.warnings() if not line.startswith("option ")]


def normals_of(facets, **more):
    return corner_normals(facets, np.ones(len(facets.ids), dtype=bool), **more)


def curve(points, closed=False):
    """Segments through points (n, 2), the outward normal to the right."""
    n = len(points)
    nodes = np.column_stack([np.arange(n), np.arange(1, n + 1) % n])[: n if closed else n - 1]
    return Facets(np.arange(len(nodes)), np.full(len(nodes), 2), nodes, np.asarray(points)[nodes])


def arc(n, radius=1.0, seed=None):
    """A quarter of a circle, in the mathematical sense, nodes at random places if a seed is given."""
    t = np.linspace(0.0, 0.5 * np.pi, n + 1)
    if seed is not None:
        t[1:-1] += np.random.default_rng(seed).uniform(-0.3, 0.3, n - 1) * t[1]
    return radius * np.column_stack([np.cos(t), np.sin(t)])


def patch(n, place, triangles, seed=1):
    """Facets over a grid of n x n, moved at random within itself and placed by a function of (u, v)."""
    u = np.linspace(-0.5, 0.5, n + 1)
    u, v = np.meshgrid(u, u, indexing="ij")
    noise = np.random.default_rng(seed).uniform(-0.2, 0.2, (2, n + 1, n + 1)) / n
    inner = np.zeros((n + 1, n + 1))
    inner[1:-1, 1:-1] = 1.0
    x = place(u + inner * noise[0], v + inner * noise[1]).reshape(-1, 3)
    i = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    nodes = np.stack([i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]], axis=-1).reshape(-1, 4)
    if triangles:
        nodes = np.concatenate([nodes[:, [0, 1, 2, 0]], nodes[:, [0, 2, 3, 0]]])
    count = np.full(len(nodes), 3 if triangles else 4)
    return Facets(np.arange(len(nodes)), count, nodes, x[nodes])


def sphere(u, v):
    return np.stack([u, v, np.sqrt(1.0 - u**2 - v**2)], axis=-1)


def paraboloid(u, v):
    return np.stack([u, v, 0.3 * u**2 - 0.2 * u * v + 0.1 * v**2], axis=-1)


def corners(facets, values):
    """Values (nf, m, ...) at the corners that exist."""
    return values[np.arange(values.shape[1])[None, :] < facets.count[:, None]]


# --- normals and offsets


def test_normals_of_a_circle_converge():
    """Also at both ends of the arc, and on nodes at random places."""
    errors = []
    for n in (8, 16, 32):
        facets = curve(arc(n, seed=3))
        normals, bent = normals_of(facets)
        assert bent.all()
        errors.append(np.max(np.linalg.norm(normals - facets.x, axis=2)))
    assert errors[0] < 0.01
    assert all(fine < 0.3 * coarse for coarse, fine in pairwise(errors)), errors


@pytest.mark.parametrize("triangles", [True, False])
def test_normals_in_space_converge(triangles):
    """On a sphere and on a paraboloid, at the border of the patch, too."""
    for place in (sphere, paraboloid):
        errors = []
        for n in (8, 16):
            facets = patch(n, place, triangles)
            x = corners(facets, facets.x)
            exact = x
            if place is paraboloid:
                exact = np.column_stack([0.2 * x[:, 1] - 0.6 * x[:, 0], 0.2 * x[:, 0] - 0.2 * x[:, 1], 0 * x[:, 0] + 1])
                exact /= np.linalg.norm(exact, axis=1)[:, None]
            errors.append(np.max(np.linalg.norm(corners(facets, normals_of(facets)[0]) - exact, axis=1)))
        assert errors[0] < 0.02 and errors[1] < 0.35 * errors[0], (place, errors)


def test_means_are_exact_on_a_sphere():
    """Inside; at the border the other half of the facets is missing."""
    facets = patch(8, sphere, True)
    normals, x = corners(facets, normals_of(facets, fitted=False)[0]), corners(facets, facets.x)
    inside = np.max(np.abs(x[:, :2]), axis=1) < 0.49
    np.testing.assert_allclose(normals[inside], x[inside], atol=1e-13)


def offset_by_hand(x, normals, w):
    """Linear interpolation of quadratic heights misses half of the sum over pairs of corners."""
    height = 0.0
    for i in range(len(w)):
        for j in range(i):
            height += 0.5 * w[i] * w[j] * np.dot(normals[j] - normals[i], x[j] - x[i])
    mean = sum(a * b for a, b in zip(w, normals, strict=True))
    return height * mean / np.linalg.norm(mean)


@pytest.mark.parallel
def test_offsets_are_the_sagitta(shared_tmp):
    """Of both circles of the rings, at the points of a rule, on meshes of one and of any number of ranks."""
    largest = []
    for n in (8, 16):
        path = make_mesh(rings, shared_tmp / f"rings{n}.msh", n=n)
        space = make_space(COMM, path, ["outer", "inner"])
        errors = [0.0]
        for name, sense in (("inner_outer_skin", 1.0), ("outer_inner_skin", -1.0)):
            surface = smooth_surface(space, name, True)
            for facets in space.mesh.facet_groups.get(name, []):
                x = space.points[space.facet_nodes(facets)]
                rows = np.arange(len(x))
                for s in (0.1, 0.5, 0.8):
                    w = np.tile([1.0 - s, s], (len(x), 1))
                    found, at = surface.offset(rows, w), np.einsum("fm,fmd->fd", w, x)
                    by_hand = [offset_by_hand(*one) for one in zip(x, surface.normals, w, strict=True)]
                    np.testing.assert_allclose(found, np.reshape(by_hand, found.shape), atol=1e-15)
                    radius = np.linalg.norm(at + found, axis=1)
                    errors.append(np.max(np.abs(radius - 0.6), initial=0.0))
                    assert np.all(sense * np.einsum("fd,fd->f", found, surface.normals[:, 0]) > 0.0)
        largest.append(COMM.allreduce(max(errors), op=MPI.MAX))
    sagitta = 0.6 * (1.0 - np.cos(np.pi / 4 / 8))
    assert largest[0] < 0.02 * sagitta and largest[1] < 0.1 * largest[0]


@pytest.mark.parallel
def test_normals_do_not_depend_on_the_ranks(shared_tmp):
    path = make_mesh(shells, shared_tmp / "shells.msh", h=0.15)
    surfaces = []
    for comm in (COMM, SELF):
        space = make_space(comm, path, ["outer", "inner"])
        surface, keys = smooth_surface(space, "inner_outer_skin", True), []
        for facets in space.mesh.facet_groups.get("inner_outer_skin", []):
            keys += np.round(space.points[space.facet_nodes(facets)].mean(axis=1), 9).tolist()
        surfaces.append(dict(zip(map(tuple, keys), surface.normals, strict=True)))
    assert COMM.allreduce(len(surfaces[0])) == len(surfaces[1])
    for key, normals in surfaces[0].items():
        np.testing.assert_allclose(normals, surfaces[1][key], atol=1e-11)


# --- edges


def box_facets():
    """The surface of a cube, 3 x 3 quadrilaterals on each face, corners shared."""
    points, faces = {}, []
    for axis in range(3):
        for side in (0.0, 1.0):
            for i in range(3):
                for j in range(3):
                    square = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
                    square = square if side else square[::-1]
                    x = np.full((4, 3), side)
                    x[:, [(axis + 1) % 3, (axis + 2) % 3]] = np.array(square) / 3.0
                    faces.append([points.setdefault(tuple(np.round(p, 6)), len(points)) for p in x])
    nodes, x = np.array(faces), np.array(list(points))
    return Facets(np.arange(len(nodes)), np.full(len(nodes), 4), nodes, x[nodes])


def assert_straight(facets):
    normals, bent = normals_of(facets)
    assert not bent.any()
    np.testing.assert_array_equal(normals, np.repeat(facet_normals(facets)[:, None], normals.shape[1], axis=1))


def test_edges_stay():
    """A cube, a blunt wedge, a saw: nothing is rounded."""
    assert_straight(box_facets())
    x = np.linspace(1.0, -1.0, 9)
    assert_straight(curve(np.column_stack([x, -0.1 * np.abs(x)])))
    assert_straight(curve(np.column_stack([x, 0.03 * (-1.0) ** np.arange(9)])))


def test_the_rim_of_a_cylinder_stays():
    """A disk on top of a quarter of a cylinder: the side is round up to the rim, the top is flat."""
    n, t = 6, np.linspace(0.0, 0.5 * np.pi, 7)
    circle = np.column_stack([np.cos(t), np.sin(t)])
    low, high = (np.column_stack([circle, np.full(n + 1, z)]) for z in (0.0, 0.3))
    x = np.concatenate([low, high, [[0.0, 0.0, 0.3]]])
    side = [[k, k + 1, n + 2 + k, n + 1 + k] for k in range(n)]
    top = [[n + 1 + k, n + 2 + k, 2 * n + 2, n + 1 + k] for k in range(n)]
    nodes = np.array(side + top)
    facets = Facets(np.arange(2 * n), np.repeat([4, 3], n), nodes, x[nodes])
    normals, bent = normals_of(facets)
    assert bent[:n].all() and not bent[n:].any()
    exact = facets.x[:n] * [1.0, 1.0, 0.0]
    assert np.max(np.linalg.norm(normals[:n] - exact, axis=2)) < 0.01


def test_the_tip_of_a_cone_stays():
    """The fit through a tip leaves a good part of the heights; around it the cone is round."""
    n, rings_, t = 24, 4, 2.0 * np.pi * np.arange(24) / 24
    x = [[0.0, 0.0, 0.0]]
    for k in range(1, rings_ + 1):
        x += np.column_stack([k * np.cos(t), k * np.sin(t), np.full(n, -0.2 * k)]).tolist()
    nodes = [[0, 1 + k, 1 + (k + 1) % n, 0] for k in range(n)]
    for r in range(rings_ - 1):
        a, b = 1 + r * n, 1 + (r + 1) * n
        nodes += [[a + k, b + k, b + (k + 1) % n, a + (k + 1) % n] for k in range(n)]
    nodes, x = np.array(nodes), np.array(x)
    facets = Facets(np.arange(len(nodes)), np.repeat([3, 4], [n, 3 * n]), nodes, x[nodes])
    normals, _ = normals_of(facets)
    np.testing.assert_allclose(normals[:n, 0], facet_normals(facets)[:n], atol=1e-15)


# --- pressures


@pytest.mark.parallel
@pytest.mark.parametrize("source", ["inner", "outer"])
def test_rings(shared_tmp, source):
    """On straight cells as accurate as on curved ones (4 %, 2 %), where chords make 60 to 96 %."""
    errors = []
    for n in (8, 16):
        path = make_mesh(rings, shared_tmp / f"rings{n}.msh", n=n)
        found = []
        for smooth in (True, False):
            with running(ring_scene(path, 1, 0.0, source, smooth_geometry=smooth)) as (simulation, converged):
                assert converged and len(said()) == (0 if smooth else 1)
                assert any("gaps of the smooth" in line for line in simulation.describe()[0]) == smooth
                assert ("facet_error" in simulation.problem.contacts[0].summary(simulation.stepper.u)) != smooth
                found.append(measure(simulation))
        assert found[1]["plain"] > 0.5
        errors.append(found[0])
    assert errors[0]["plain"] < 0.04 and errors[1]["plain"] < 0.6 * errors[0]["plain"]
    assert errors[1]["energy"] < 0.55 * errors[0]["energy"]
    assert errors[1]["mean_pressure"] == pytest.approx(interface_pressure(), rel=5e-4)


@pytest.mark.parametrize(
    "said",
    [pytest.param({"unbiased": True, "friction": 0.2}, marks=pytest.mark.parallel), {"theta": -1.0},
     {"formulation": "penalty", "gamma0": 3.0}, {"search": "ray_tracing"}, {"cut": False, "quadrature": 9}],
)  # fmt: skip
def test_rings_of_all_kinds(shared_tmp, said):
    path = make_mesh(rings, shared_tmp / "rings.msh", n=8)
    theta = said.pop("theta", 0.0)
    errors = []
    for smooth in (True, False):
        with running(ring_scene(path, 1, theta, smooth_geometry=smooth, **{"gamma0": 1.0, **said})) as (run, converged):
            assert converged
            points = contact_points(run)
            errors.append(None if points is None else np.std(points["pressure"]) / interface_pressure())
    if errors[0] is not None:
        assert errors[0] < 0.1 * errors[1] and errors[0] < 0.2, errors


def test_rings_of_degree_2(shared_tmp):
    """Displacement of degree 2 on straight cells."""
    path = make_mesh(rings, shared_tmp / "rings.msh", n=8)
    with running(ring_scene(path, 2, 0.0, smooth_geometry=True)) as (simulation, converged):
        assert converged and measure(simulation)["plain"] < 0.03


@pytest.mark.parallel
def test_one_surface_against_itself(shared_tmp):
    """All surfaces against all: partners and their offsets come from one surface with itself."""
    path = make_mesh(rings, shared_tmp / "rings.msh", n=8)
    errors = []
    for smooth in (True, False):
        scene = ring_scene(path, 1, 0.0)
        scene.contacts = [Contact(all=True, smooth_geometry=smooth)]
        with running(scene) as (simulation, converged):
            assert converged
            points = contact_points(simulation)
        if points is not None:
            at = (np.abs(np.linalg.norm(points["x"], axis=1) - 0.6) < 0.01) & (points["x"].min(axis=1) > 1e-9)
            errors.append(np.std(points["pressure"][at]) / interface_pressure())
    assert not errors or (errors[0] < 0.1 and errors[1] > 0.5), errors


@pytest.mark.parallel
def test_obstacle(shared_tmp):
    """A ring around a rigid shaft, pressed from outside: the shaft is round, only the ring has chords."""
    path = make_mesh(rings, shared_tmp / "rings.msh", n=16)
    # Lame's ring, u = 0 at the hole
    pressure = 2.0 * (1.0 - NU) * PRESSURE / (1.0 + (1.0 - 2.0 * NU) * 0.6**2)
    shaft, errors = Obstacle(shape="sphere", center=[0.0, 0.0], radius=0.6), []
    for smooth in (True, False):
        scene = ring_scene(path, 1, 0.0)
        scene.contacts = [Contact("outer_inner_skin", obstacle=shaft, smooth_geometry=smooth)]
        scene.displacements += [Displacement("inner", [0.0, 0.0])]
        with running(scene) as (simulation, converged):
            assert converged
            points = contact_points(simulation)
        if points is not None:
            error = points["pressure"] / pressure - 1.0
            errors.append(np.sqrt(points["weight"] @ error**2 / points["weight"].sum()))
    assert not errors or (errors[0] < 0.02 and errors[1] > 0.2), errors


@pytest.mark.parallel
def test_shells(shared_tmp):
    """In space, unstructured triangles: the pressure of Lame's shells."""
    path = make_mesh(shells, shared_tmp / "shells.msh", (1.0, 0.6, 0.3), h=0.15)
    errors = []
    for smooth in (True, False):
        with running(shell_scene(path, 1, smooth_geometry=smooth)) as (simulation, converged):
            assert converged
            points = contact_points(simulation)
        if points is not None:
            error = points["pressure"] / shell_pressure() - 1.0
            errors.append(np.sqrt(points["weight"] @ error**2 / points["weight"].sum()))
    assert not errors or (errors[0] < 0.12 and errors[1] > 1.0), errors


@pytest.mark.parallel
def test_flat_surfaces_are_what_they_are(shared_tmp):
    """Blocks on meshes that do not match: nothing changes, and nothing is kept."""
    for dim, cell in ((2, "quadrilateral"), (3, "tetrahedron")):
        path, found = make_mesh(two_blocks, shared_tmp / f"{cell}.msh", dim=dim, n_lower=2, n_upper=3, cell=cell), []
        for smooth in (True, False):
            with running(block_scene(path, dim, smooth)) as (simulation, converged):
                assert converged and simulation.problem.items[1].search.chords is None
                points = contact_points(simulation)
                found.append(None if points is None else points["pressure"])
        if found[0] is not None:
            # ranks add in any order
            np.testing.assert_allclose(*found, rtol=1e-13)


def block_scene(path, dim, smooth):
    free = ["free"] * (dim - 1)
    return Scene(
        mesh=MeshSpec(path),
        materials={"m": Material(E, NU)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", smooth_geometry=smooth)],
        displacements=[Displacement("lower_bottom", [0.0] * dim), Displacement("upper_top", [*free, -0.01])],
        output=Output(fields=False),
    )


def test_the_sides_of_a_cube_stay_flat(tmp_path):
    """A block around whose edges contact is: all surfaces against an obstacle."""
    path = two_blocks(tmp_path / "cubes.msh", 3, 2, 3, "hexahedron")
    scene = block_scene(path, 3, True)
    floor = Obstacle(shape="plane", point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0])
    scene.contacts += [Contact(all=True, name="floor", obstacle=floor, smooth_geometry=True)]
    with running(scene) as (simulation, converged):
        assert converged
        assert [item.search.chords for item in simulation.problem.items[1:]] == [None, None]


# --- warnings

SCENE = """\
[mesh]
file = "rings.msh"
[materials.ring]
E = 1e9
nu = 0.2
[[bodies]]
region = "outer"
material = "ring"
[[bodies]]
region = "inner"
material = "ring"
[[contacts]]
source = "inner_outer_skin"
target = "outer_inner_skin"
name = "circle"
[[displacements]]
region = "symmetry_x"
value = [0, "free"]
[[displacements]]
region = "symmetry_y"
value = ["free", 0]
[[loads]]
region = "outer_skin"
pressure = 1e7
"""


@pytest.mark.slow
def test_what_the_user_reads(tmp_path):
    """check and run name the contact, the number, the remedy."""
    rings(tmp_path / "rings.msh", n=8)
    (tmp_path / "scene.toml").write_text(SCENE)
    checked = execute(tmp_path, ["check", "scene.toml"])
    line = next(line for line in checked.stdout.splitlines() if line.startswith("warning: contact circle:"))
    assert "10 %" in line and "smooth_geometry = true" in line
    assert execute(tmp_path, ["run", "scene.toml", "-o", "as_they_are"]).returncode == 0
    report = json.loads((tmp_path / "as_they_are" / "report.json").read_text())
    (said,) = (line for line in report["warnings"] if "circle" in line)
    assert "wrong by about" in said and "degree 2" in said
    assert report["steps"][-1]["contacts"]["circle"]["facet_error"] > 0.4


def test_the_estimate_is_about_the_error(shared_tmp):
    """Where the chords' gaps do not open the contact: within a tenth of the error against Lame."""
    path = make_mesh(rings, shared_tmp / "rings.msh", n=32)
    for gamma0 in (0.3, 1.0):
        with running(ring_scene(path, 1, 0.0, "outer", gamma0=gamma0)) as (simulation, converged):
            assert converged
            error = measure(simulation)["plain"]
            (contact,) = simulation.problem.contacts
            assert contact.summary(simulation.stepper.u)["facet_error"] == pytest.approx(error, rel=0.1)
            assert any("wrong by about" in line for line in log.warnings()) == (error > 0.1)


@pytest.mark.parallel
def test_nothing_is_said_where_facets_do_no_harm(shared_tmp):
    """Circles whose facets match, curved cells, a gap that is said, bodies bent against each other."""
    matching = make_mesh(rings, shared_tmp / "matching.msh", n=8, mismatch=1.0)
    curved = make_mesh(rings, shared_tmp / "curved.msh", n=8, order=2)
    straight = make_mesh(rings, shared_tmp / "straight.msh", n=8)
    for path, more in ((matching, {}), (curved, {}), (straight, {"clearance": 0.0, "interference": None})):
        with running(ring_scene(path, 1, 0.0, **more)) as (simulation, converged):
            assert converged and said() == []
            assert simulation.problem.contacts[0].summary(simulation.stepper.u).get("facet_error", 0.0) < 1e-3
    path = make_mesh(cylinder_on_block, shared_tmp / "hertz.msh", h=0.5, half=True, coarse=1.0)
    scene = Scene(
        mesh=MeshSpec(path),
        materials={"m": Material(200.0, 0.3)},
        bodies=[Body("cylinder", "m"), Body("block", "m")],
        contacts=[Contact("cylinder_skin", "block_top")],
        displacements=[Displacement("symmetry_x", [0.0, "free"]), Displacement("block_bottom", ["free", 0.0])],
        loads=[Load("cylinder_flat", pressure=0.625)],
        output=Output(fields=False),
    )
    with running(scene) as (simulation, converged):
        assert converged and not any("facets" in line for line in log.warnings())
        assert simulation.problem.contacts[0].summary(simulation.stepper.u)["facet_error"] == 0.0


@pytest.mark.parallel
def test_curved_facets_of_a_circle(shared_tmp):
    """Gaps are those of circles, to the borders of the surfaces; facets of degree 2 are off by 1e-5."""
    path, delta = make_mesh(rings, shared_tmp / "curved.msh", n=4, order=2, delta=6e-4), 6e-4
    for smooth, largest in ((True, 1e-8), (False, 1e-5)):
        simulation = Simulation(ring_scene(path, 2, 0.0, pressure=0.0, smooth_geometry=smooth))
        pair = simulation.problem.contacts[0].pairs[0]
        assert (pair.search.chords is None) == (not smooth)
        pair.detect(simulation.problem.space.vector(), 0.0)
        off = np.abs(pair.pairing.gap0[pair.pairing.paired] + delta)
        off = COMM.allreduce(float(np.max(off, initial=0.0)), op=MPI.MAX)
        assert off < largest if smooth else off > largest
        simulation.free()


@pytest.mark.parametrize("place", ["sphere", "cylinder"])
def test_curved_facets_in_space(place):
    """The surface through the edges of triangles of degree 2 is nearer to the one that they stand for, at the border,
    too."""
    axes = np.array([1.0, 1.0 if place == "sphere" else 0.0, 1.0])

    def on(x):
        return x * (1.0 - axes + axes / np.linalg.norm(axes * x, axis=-1, keepdims=True))

    n = 4
    u, v = (one.ravel() for one in np.meshgrid(np.linspace(-0.5, 0.5, n + 1), np.linspace(-0.5, 0.5, n + 1)))
    i = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (one.ravel() for one in (i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]))
    nodes = np.concatenate([np.column_stack([a, b, c, a]), np.column_stack([a, c, d, a])])
    x, nf = on(np.column_stack([u, v, np.ones_like(u)]))[nodes], len(nodes)
    middles = np.full((nf, 4, 4, 3), np.nan)
    for p, q in ((0, 1), (1, 2), (2, 0)):
        middles[:, p, q] = middles[:, q, p] = on(0.5 * (x[:, p] + x[:, q]))
    count = np.full(nf, 3)
    facets = Facets(np.arange(nf), count, nodes, x, own_normals(x, count, middles))
    normals, border, bent, _ = curved_normals(facets, np.ones(nf, dtype=bool))
    assert bent.any() and border.any() and not border.all()
    surface = SmoothSurface(facets, normals, middles, border)
    rng = np.random.default_rng(2)
    weights = rng.uniform(size=(nf, 5, 1)) * [1.0, -1.0, 0.0] + [0.0, 1.0, 0.0]
    turned = zip(weights, rng.integers(3, size=nf), strict=True)
    weights = np.stack([np.roll(one, turn, axis=1) for one, turn in turned])
    shapes = np.concatenate([weights * (2.0 * weights - 1.0), 4.0 * weights * np.roll(weights, -1, axis=2)], axis=2)
    six = np.concatenate([x[:, :3], middles[:, [0, 1, 2], [1, 2, 0]]], axis=1)
    points = np.einsum("fka,fad->fkd", shapes, six).reshape(-1, 3)
    weights = np.concatenate([weights, np.zeros((nf, 5, 1))], axis=2).reshape(-1, 4)
    moved = points + surface.offset(np.repeat(np.arange(nf), 5), weights)
    before, after = (np.linalg.norm(axes * one, axis=1) - 1.0 for one in (points, moved))
    assert np.sqrt(np.mean(after**2)) < 0.5 * np.sqrt(np.mean(before**2))


@pytest.mark.parallel
def test_heights_above_curved_triangles(shared_tmp):
    """Inside of the facets of two spheres, too, whose middles are where degree 2 has them."""
    path = make_mesh(shells, shared_tmp / "shells2.msh", (1.0, 0.6, 0.3), h=0.25, order=2)
    space = make_space(COMM, path, ["outer", "inner"], 2)
    points, _ = quadrature("triangle", 6)
    # triangles have a fourth corner without weight
    weights = np.pad(shape("triangle", 1, points), ((0, 0), (0, 1)))
    for name in ("inner_outer_skin", "outer_inner_skin"):
        surface, first, sums = smooth_surface(space, name, True), 0, np.zeros(2)
        for facets in space.mesh.facet_groups.get(name, []):
            x = shape("triangle", 2, points) @ space.mesh.points[space.mesh.facet_nodes(facets)]
            rows = np.repeat(np.arange(first, first + len(x)), len(points))
            found = x.reshape(-1, 3) + surface.offset(rows, np.tile(weights, (len(x), 1)))
            first += len(x)
            off = [np.linalg.norm(one, axis=-1).ravel() - 0.6 for one in (x, found)]
            sums += [np.sum(one**2) for one in off]
        before, left = np.sqrt(COMM.allreduce(sums, op=MPI.SUM))
        # heights above the edges alone leave nine tenths
        assert left < 0.25 * before
