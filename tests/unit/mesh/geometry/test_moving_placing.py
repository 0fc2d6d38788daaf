"""Nodes of refined meshes lie on the geometry: curves and surfaces, valid cells, any number of ranks, wrong files."""

import logging

import gmsh
import numpy as np
import pytest

from drivers._common import make_mesh
from meshes import geometries, rings
from meshes.shells import shells, tubes
from pcontact.mesh.distribute import load_mesh, load_plain
from pcontact.mesh.geometry.moving import put_on
from pcontact.mesh.raw import Block, RawMesh, complete
from pcontact.mesh.refinement.gather import gathered
from pcontact.mesh.refinement.refine import refine
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from tests.support.refined import chosen, volume

COMM = MPI.COMM_WORLD
SKINS = ("outer_skin", "outer_inner_skin", "inner_outer_skin", "inner_skin")


def given(path, text):
    on_root(COMM, path.write_text, text)
    return path


def load(path, order, geometry, comm=COMM):
    mesh = load_mesh(comm, path, order, ["outer", "inner"], [], lambda mesh: None)
    put_on(mesh, geometry, "scene.toml")
    return mesh


def all_cut(mesh, cuts):
    return refine(mesh, np.full(sum(len(block.nodes) for block in mesh.blocks), cuts))[0]


def off(mesh, radii, directions):
    """How far nodes of the skins are from circles, cylinders or spheres, at most."""
    far = 0.0
    for name, radius in zip(SKINS, radii, strict=True):
        for facets in mesh.facet_groups.get(name, []):
            nodes = mesh.facet_nodes(facets)
            nodes = nodes if mesh.curved else nodes[:, : {"segment": 2, "triangle": 3, "quadrilateral": 4}[facets.kind]]
            distance = np.linalg.norm(mesh.points[nodes.ravel(), :directions], axis=1)
            far = max(far, float(np.abs(distance - radius).max(initial=0.0)))
    return mesh.comm.allreduce(far, op=MPI.MAX)


@pytest.mark.parallel
@pytest.mark.parametrize("cell, order, rate", [
    ("triangle", 1, 1.9), ("triangle", 2, 3.8), ("quadrilateral", 1, 1.95), ("quadrilateral", 2, 3.9),
])  # fmt: skip
def test_a_straight_mesh_of_rings(shared_tmp, cell, order, rate):
    """Nodes lie on the circles, and the area converges as fast as cells of the degree can follow circles."""
    geometry = given(shared_tmp / "rings.geo", geometries.rings(delta=6e-4))
    mesh = load(make_mesh(rings, shared_tmp / "rings.msh", n=4, cell=cell, delta=6e-4), order, geometry)
    area, errors = 0.25 * np.pi * (1.0 - 0.36 + 0.6006**2 - 0.04), []
    assert mesh.curved == (order == 2)
    for _ in range(3):
        mesh = all_cut(mesh, 2)
        assert off(mesh, (1.0, 0.6, 0.6006, 0.2), 2) < 1e-14
        errors.append(abs(volume(mesh) / area - 1.0))
    # cells that follow from others are not all halved alike
    assert np.log2(errors[0] / errors[2]) / 2 > rate


@pytest.mark.parallel
@pytest.mark.parametrize("order", [1, 2])
def test_spheres(shared_tmp, order):
    """Tetrahedra, locally refined: nodes on the spheres, valid cells (checked by `volume`), the volume converges."""
    geometry = given(shared_tmp / "shells.geo", geometries.shells())
    path = make_mesh(shells, shared_tmp / "shells.msh", h=0.4)
    exact, mesh = np.pi / 6.0 * (1.0 - 0.3**3), load(path, order, geometry)
    first = abs(volume(mesh) / exact - 1.0)
    for cuts in (np.full(sum(len(block.nodes) for block in mesh.blocks), 3), None):
        mesh, _ = refine(mesh, chosen(mesh, 3, 0.02, 6) if cuts is None else cuts)
        assert off(mesh, (1.0, 0.6, 0.6, 0.3), 3) < 1e-14
        assert abs(volume(mesh) / exact - 1.0) < first / (4.0 if order == 1 else 16.0)


@pytest.mark.parallel
@pytest.mark.parametrize("cell, make, text", [
    ("tetrahedron", shells, geometries.shells), ("hexahedron", tubes, geometries.tubes),
])  # fmt: skip
def test_any_number_of_ranks(shared_tmp, cell, make, text):
    """Nodes and cells are, bit by bit, those of one rank."""
    geometry = given(shared_tmp / f"{cell}.geo", text())
    path = make_mesh(make, shared_tmp / f"{cell}.msh", **({"h": 0.4} if cell == "tetrahedron" else {"n": 3}))
    found = []
    for comm in (COMM, MPI.COMM_SELF):
        mesh = load(path, 2, geometry, comm)
        for seed in range(2):
            wish = chosen(mesh, seed, 0.3, 3) if cell == "tetrahedron" else np.ones(len(mesh.blocks[0].nodes))
            mesh, _ = refine(mesh, wish if seed == 0 or cell == "tetrahedron" else 0 * wish)
        found.append(gathered(mesh, path))
    if COMM.rank == 0:
        one, other = found
        assert np.array_equal(one.points, other.points)
        assert all(np.array_equal(p.nodes, q.nodes) for p, q in zip(one.blocks, other.blocks, strict=True))


@pytest.mark.parametrize("order", [1, 2])
def test_a_layer_that_is_thinner_than_arcs_are_deep(tmp_path, caplog, order):
    """Nodes come as near to the hole as cells stay valid, and the program says that they are not on it."""
    angles, radii = np.linspace(0.0, 0.5 * np.pi, 5), (0.5, 0.505, 1.0)
    points = np.array([[r * np.cos(t), r * np.sin(t)] for r in radii for t in angles])
    quads = np.array([[5 * k + i, 5 * k + i + 5, 5 * k + i + 6, 5 * k + i + 1] for k in range(2) for i in range(4)])
    raw = RawMesh(tmp_path, 2, points, [Block("triangle", 1, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]))])
    raw.cell_groups["all"] = np.arange(16)
    geometry = tmp_path / "ring.geo"
    geometry.write_text(geometries.rings((1.0, 0.5, 0.2)))
    mesh = load_plain(MPI.COMM_SELF, raw if order == 1 else complete(raw, 2))
    with caplog.at_level(logging.WARNING):
        put_on(mesh, geometry, "scene.toml")
        mesh = all_cut(mesh, 2)
    assert "new nodes stay off its curves" in caplog.text
    # cells that are turned over would fail here
    assert volume(mesh) == pytest.approx(0.25 * np.pi * 0.75, rel=0.01)


@pytest.mark.parametrize("name, text, factor, words", [
    ("g.step", "ISO-10303-21;\nHEADER;\n", 1.0, "cannot read"),
    ("g.geo", "Point(1) = {0, 0;\n", 1.0, "syntax error"),
    ("g.brep", "nothing\n", 1.0, "without curves"),
    ("g.geo", geometries.rings(), 1e-3, "30 of 30 vertices of the boundary are: .* the mesh is 0.001 times as large"),
    ("g.geo", geometries.rings((1.0, 0.6, 0.25)), 1.0, "vertices of the boundary are: the first one, at .* from them;"),
], ids=["damaged", "syntax", "empty", "units", "another"])  # fmt: skip
def test_wrong_geometries(tmp_path, capfd, name, text, factor, words):
    """One line names scene, key, file, and what is wrong; libraries print nothing of their own."""
    (tmp_path / name).write_text(text)
    path = make_mesh(rings, tmp_path / "rings.msh", n=4, cell="triangle")
    mesh = load_mesh(MPI.COMM_SELF, path, 1, ["outer", "inner"], [], lambda mesh: None)
    mesh.points *= factor
    capfd.readouterr()
    with pytest.raises(InputError, match=f"scene.toml: mesh.geometry: found '.*{name}', .*{words}"):
        put_on(mesh, tmp_path / name, "scene.toml")
    assert capfd.readouterr().out == ""


def test_gmsh_of_the_caller_stays_open(tmp_path):
    """Models and options of somebody who has gmsh open are there afterwards."""
    geometry = tmp_path / "rings.geo"
    geometry.write_text(geometries.rings())
    path = make_mesh(rings, tmp_path / "rings.msh", n=4, cell="triangle")
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.model.add("theirs")
        gmsh.model.geo.addPoint(1.0, 2.0, 3.0)
        gmsh.model.geo.synchronize()
        gmsh.option.setNumber("General.Terminal", 1)
        load(path, 2, geometry, MPI.COMM_SELF)
        assert gmsh.model.getCurrent() == "theirs" and gmsh.model.getEntities() == [(0, 1)]
        assert gmsh.option.getNumber("General.Terminal") == 1
    finally:
        gmsh.finalize()
