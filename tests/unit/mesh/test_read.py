"""Reading, checking and completing meshes."""

import re

import gmsh
import meshio
import numpy as np
import pytest

from pcontact.element.reference import CELLS, facet_nodes, reference_nodes
from pcontact.mesh import msh
from pcontact.mesh.msh import VTK_ORDER
from pcontact.mesh.raw import Block, RawMesh, complete, facet_multiplicity, facets_of_nodes, number_rows
from pcontact.mesh.read import read_mesh
from pcontact.mesh.topology import components, mirror
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from tests.support.raw_meshes import (
    CELL_TYPES,
    check_line,
    check_straight,
    corners,
    determinants,
    normals,
    stack,
    volume,
)

FORMATS = [(2.2, 0), (2.2, 1), (4.1, 0), (4.1, 1)]


def _write(path, cell, order=1, serendipity=0, version=4.1, binary=0):
    gmsh.option.setNumber("Mesh.SecondOrderIncomplete", serendipity)
    stack(cell)
    gmsh.model.mesh.setOrder(order)
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.write(str(path))
    gmsh.model.remove()
    return path


@pytest.mark.parametrize("cell", [*CELL_TYPES, "wedge"])
@pytest.mark.parametrize("order, serendipity", [(1, 0), (2, 0), (2, 1)])
def test_gmsh_cells(session, tmp_path, cell, order, serendipity):
    raw = read_mesh(_write(tmp_path / "m.msh", cell, order, serendipity))
    dim = CELLS[cell].dim
    assert (raw.dim, [(b.cell, b.degree) for b in raw.blocks]) == (dim, [(cell, order)])
    assert raw.points.flags.c_contiguous and raw.points.shape[1] == dim
    assert all(b.nodes.dtype == np.int64 and b.nodes.flags.c_contiguous for b in raw.blocks)
    assert min(d.min() for d in determinants(raw)) > 0
    assert volume(raw) == pytest.approx(2.0)
    check_straight(raw)
    # every node once, and none to spare
    assert len(np.unique(np.round(raw.points, 9), axis=0)) == len(raw.points)
    np.testing.assert_array_equal(np.unique(raw.blocks[0].nodes), np.arange(len(raw.points)))
    if CELLS[cell].is_tensor:
        assert len(raw.points) == (2 * order + 1) ** (dim - 1) * (4 * order + 1)
    _check_groups(raw, order)


@pytest.mark.parametrize(("kind", "cell"), [
    (13, "wedge"), (18, "wedge15"), (14, "pyramid"), (19, "pyramid13"),
])  # fmt: skip
def test_orders_of_nodes_are_those_of_gmsh(session, kind, cell):
    """Positions of gmsh's nodes, by gmsh itself, in the order that the reader gives them."""
    places = np.reshape(gmsh.model.mesh.getElementProperties(kind)[4], (-1, 3))
    np.testing.assert_allclose(places[VTK_ORDER[kind]], reference_nodes(cell, 2), atol=1e-12)


def _check_groups(raw, order):
    dim, n = raw.dim, raw.offsets[-1]
    solid, skin = ("surface", "curve") if dim == 2 else ("volume", "surface")
    assert set(raw.cell_groups) == {"lower", f"{solid}_8"}
    both = np.concatenate([raw.cell_groups["lower"], raw.cell_groups[f"{solid}_8"]])
    np.testing.assert_array_equal(np.sort(both), np.arange(n))
    centre = raw.points[raw.blocks[0].vertices].mean(axis=1)[:, -1]
    np.testing.assert_array_equal(raw.cell_groups["lower"], np.flatnonzero(centre < 1))
    assert set(raw.facet_groups) == {"bottom", "interface", f"{skin}_13"}
    for name, height, sign in (("bottom", 0, -1), (f"{skin}_13", 2, 1)):
        np.testing.assert_allclose(corners(raw, name)[..., -1], height)
        np.testing.assert_allclose(normals(raw, name).sum(axis=0), sign * np.eye(dim)[-1], atol=1e-12)
        np.testing.assert_array_equal(facet_multiplicity(raw, *raw.facet_groups[name]), 1)
    np.testing.assert_array_equal(facet_multiplicity(raw, *raw.facet_groups["interface"]), 2)
    np.testing.assert_allclose(np.linalg.norm(normals(raw, "interface"), axis=1).sum(), 1)
    np.testing.assert_allclose(raw.points[raw.node_groups["corner"]], np.zeros((1, dim)))
    if dim == 3:
        assert len(raw.node_groups["rim"]) == 2 * order + 1
        np.testing.assert_allclose(raw.points[raw.node_groups["rim"]][:, 1:], [[0, 2]] * (2 * order + 1))
        assert raw.edge_groups["rim"].shape == (2, 2)


@pytest.mark.parametrize("version, binary", [*FORMATS, (1, 0), (4.0, 0)])
@pytest.mark.parametrize("cell, order", [("quadrilateral", 1), ("tetrahedron", 2)])
def test_gmsh_formats(session, tmp_path, monkeypatch, cell, order, version, binary):
    """Those of today without gmsh; others are translated by gmsh in a process of its own."""
    path = _write(tmp_path / "m.msh", cell, order, 0, version, binary)
    if version in (1, 4.0):
        monkeypatch.setattr(msh, "available", lambda: False)
        with pytest.raises(InputError, match=f"version {version:g} .*gmsh") as caught:
            read_mesh(path)
        check_line(caught.value, path)
        monkeypatch.undo()
    raw = read_mesh(path)
    check_straight(raw)
    if version == 1:
        # it has no names
        assert sorted(raw.cell_groups.values(), key=len)[0].size == 0.5 * raw.offsets[-1]
    else:
        _check_groups(raw, order)


def test_partitioned_mesh(session, tmp_path):
    """gmsh puts the parts together again."""
    path = _write(tmp_path / "m.msh", "triangle")
    gmsh.open(str(path))
    gmsh.model.mesh.partition(2)
    gmsh.write(str(path))
    assert b"$PartitionedEntities" in path.read_bytes()
    _check_groups(read_mesh(path), 1)


def test_callers_gmsh_model_survives(session, tmp_path):
    path = _write(tmp_path / "m.msh", "triangle")
    gmsh.model.add("mine")
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    before = gmsh.model.list()
    read_mesh(path)
    with pytest.raises(InputError):
        read_mesh(_text(tmp_path, SQUARE, [(1, 2, 2, 1, 1, 1, 2, 99)]))
    assert gmsh.model.list() == before and gmsh.model.getCurrent() == "mine"
    assert len(gmsh.model.getEntities(3)) == 1


@pytest.mark.parametrize("save_all", [0, 1])
def test_circle_centre_is_dropped(session, tmp_path, save_all):
    _half_disc()
    gmsh.option.setNumber("Mesh.SaveAll", save_all)
    gmsh.write(str(tmp_path / "disc.msh"))
    raw = read_mesh(tmp_path / "disc.msh")
    assert np.linalg.norm(raw.points - [0.0, -0.5], axis=1).min() > 0.01
    assert {"disc", "again"} == set(raw.cell_groups) and {"arc", "half arc"} == set(raw.facet_groups)


def _half_disc():
    geo = gmsh.model.geo
    gmsh.model.add("disc")
    # the centre of the arc is outside the piece
    c, a, b, d = (geo.addPoint(*x, 0) for x in ((0, -0.5), (1, 0), (0, np.sqrt(1.25) - 0.5), (-1, 0)))
    arcs = [geo.addCircleArc(a, c, b), geo.addCircleArc(b, c, d)]
    disc = geo.addPlaneSurface([geo.addCurveLoop([*arcs, geo.addLine(d, a)])])
    geo.synchronize()
    for dim, tags, name in (
        (2, [disc], "disc"),
        (2, [disc], "again"),
        (1, arcs, "arc"),
        (1, arcs[:1], "half arc"),
    ):
        gmsh.model.addPhysicalGroup(dim, tags, name=name)
    gmsh.model.mesh.generate(2)


@pytest.mark.parametrize("version, binary", FORMATS)
def test_entity_in_several_groups(session, tmp_path, version, binary):
    _half_disc()
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.write(str(tmp_path / "disc.msh"))
    raw = read_mesh(tmp_path / "disc.msh")
    n = raw.offsets[-1]
    for name in ("disc", "again"):
        np.testing.assert_array_equal(raw.cell_groups[name], np.arange(n))
    whole, half = (set(zip(*raw.facet_groups[name], strict=True)) for name in ("arc", "half arc"))
    assert half < whole and len(whole) == 2 * len(half)


def test_centre_in_a_group_is_left_out(session, tmp_path):
    _half_disc()
    gmsh.model.addPhysicalGroup(0, [1], name="centre")
    gmsh.write(str(tmp_path / "disc.msh"))
    raw = read_mesh(tmp_path / "disc.msh")
    assert list(raw.lost) == ["centre"] and "centre" not in raw.node_groups
    found = r"node .* at \(0, -0.5, 0\) belongs to no cell of dimension 2 \(1 in all\); allowed"
    assert re.match(found, raw.lost["centre"])


def test_groups_of_a_version_2_file_stay_apart_within_an_entity(tmp_path):
    elements = [(1, 2, 2, 1, 1, 1, 2, 3), (2, 2, 2, 2, 1, 1, 3, 4)]
    raw = read_mesh(_text(tmp_path, SQUARE, elements))
    assert {name: cells.tolist() for name, cells in raw.cell_groups.items()} == {
        "surface_1": [0],
        "surface_2": [1],
    }


def test_surfaces_of_opposite_sense(tmp_path):
    """gmsh numbers the cells of each plane surface in the sense of its own boundary loop."""
    elements = [(1, 2, 2, 1, 1, 1, 2, 3), (2, 2, 2, 1, 2, 1, 4, 3)]
    raw = read_mesh(_text(tmp_path, SQUARE, elements))
    assert min(d.min() for d in determinants(raw)) > 0


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize("cell", CELL_TYPES)
def test_reversed_meshes_are_turned_and_scale_does_not_matter(session, tmp_path, capsys, cell, scale):
    raw = read_mesh(_write(tmp_path / "m.msh", cell, 2))
    (block,) = raw.blocks
    nodes = block.nodes[:, mirror(cell, 2)]
    kind = {"triangle": "triangle6", "quadrilateral": "quad9", "tetrahedron": "tetra10"}.get(
        cell, "hexahedron27"
    )
    points = np.zeros((len(raw.points), 3))
    points[:, : raw.dim] = scale * raw.points
    meshio.Mesh(points, [(kind, nodes)]).write(tmp_path / "m.vtu")
    other = read_mesh(tmp_path / "m.vtu")
    assert volume(other) == pytest.approx(2.0 * scale**raw.dim)
    check_straight(RawMesh(other.path, other.dim, other.points / scale, other.blocks))
    # the same with some cells turned
    nodes = block.nodes.copy()
    nodes[1:5] = nodes[1:5][:, mirror(cell, 2)]
    meshio.Mesh(points, [(kind, nodes)]).write(tmp_path / "m.vtu")
    log.setup(level="debug")
    other = read_mesh(tmp_path / "m.vtu")
    assert f"4 of {len(nodes)} cells were numbered in the opposite sense: turned" in capsys.readouterr().out
    np.testing.assert_array_equal(other.blocks[0].nodes, block.nodes)


@pytest.mark.parametrize("cell", CELL_TYPES)
@pytest.mark.parametrize("reverse", [False, True])
def test_folded_cells_are_not_turned(session, tmp_path, cell, reverse):
    """A cell that a node in a wrong place puts onto its neighbour is not only numbered in another sense."""
    dim, kind = CELLS[cell].dim, {"quadrilateral": "quad", "tetrahedron": "tetra"}.get(cell, cell)
    n_facet = len(facet_nodes(cell, 1)[0])
    (a,) = read_mesh(_write(tmp_path / "m.msh", cell)).blocks
    x = reference_nodes(cell, 1) if CELLS[cell].is_tensor else reference_nodes(cell, 1) - 1.0
    if CELLS[cell].is_tensor:
        # a second cell behind the facet x = 1, folded back onto the first
        far = np.flatnonzero(x[:, 0] < 0)
        near = [int(np.flatnonzero((x[:, 1:] == x[k, 1:]).all(axis=1) & (x[:, 0] > 0))[0]) for k in far]
        second = np.empty(len(x), dtype=np.int64)
        second[far], second[near] = near, len(x) + np.arange(len(far))
        points = np.vstack([x, x[far] * np.r_[0.5, np.ones(dim - 1)]])
    else:
        # a second cell on the facet of all vertices but the last, whose own last vertex is on the same side
        second = np.r_[np.arange(dim), dim + 1]
        second[[0, 1]] = second[[1, 0]]
        points = np.vstack([x, x.mean(axis=0)])
    assert a.cell == cell and n_facet <= len(second)
    cells = np.array([np.arange(len(x)), second])
    if reverse:
        cells = cells[:, mirror(cell, 1)]
    lifted = np.zeros((len(points), 3))
    lifted[:, :dim] = points
    meshio.Mesh(lifted, [(kind, cells)]).write(tmp_path / "m.vtu")
    with pytest.raises(InputError, match=r"cell [12] \(.*inverted"):
        read_mesh(tmp_path / "m.vtu")


@pytest.mark.parametrize("cell", CELL_TYPES)
@pytest.mark.parametrize("degree", [1, 2])
def test_mirror(cell, degree):
    swap = mirror(cell, degree)
    nodes = reference_nodes(cell, degree)
    # the affine map (or, for the vertices of tensor cells, the reflection) that the swap stands for
    np.testing.assert_array_equal(swap[swap], np.arange(len(nodes)))
    a = np.linalg.lstsq(np.c_[nodes, np.ones(len(nodes))], nodes[swap], rcond=None)[0]
    np.testing.assert_allclose(np.c_[nodes, np.ones(len(nodes))] @ a, nodes[swap], atol=1e-14)
    assert np.linalg.det(a[:-1]) == pytest.approx(-1)


# --- other formats


def test_vtu_with_tags_and_mixed_cells(tmp_path):
    points = np.array([[0, 0, 3], [1, 0, 3], [1, 1, 3], [0, 1, 3], [2, 0.5, 3]], dtype=float)
    cells = [
        ("quad", [[0, 1, 2, 3]]),
        ("triangle", [[1, 4, 2]]),
        ("line", [[0, 1], [1, 2]]),
        ("vertex", [[4]]),
    ]
    data = {"gmsh:physical": [[5], [6], [9, 10], [2]]}
    meshio.Mesh(points, cells, cell_data=data).write(tmp_path / "m.vtu")
    raw = read_mesh(tmp_path / "m.vtu")
    assert [(b.cell, len(b.nodes)) for b in raw.blocks] == [("quadrilateral", 1), ("triangle", 1)]
    assert {k: v.tolist() for k, v in raw.cell_groups.items()} == {"surface_5": [0], "surface_6": [1]}
    facets = {k: (c.tolist(), f.tolist()) for k, (c, f) in raw.facet_groups.items()}
    assert facets == {"curve_9": ([0], [0]), "curve_10": ([0], [1])}
    assert raw.node_groups["point_2"].tolist() == [4]
    assert facet_multiplicity(raw, *raw.facet_groups["curve_10"]).tolist() == [2]
    full = complete(raw, 2)
    assert len(full.points) == 5 + 6 + 1
    check_straight(full)


def test_inp(session, tmp_path):
    stack("hexahedron")
    gmsh.option.setNumber("Mesh.SaveGroupsOfNodes", 1)
    gmsh.write(str(tmp_path / "m.inp"))
    raw = read_mesh(tmp_path / "m.inp")
    assert [(b.cell, b.degree) for b in raw.blocks] == [("hexahedron", 1)]
    assert volume(raw) == pytest.approx(2.0)
    assert len(raw.cell_groups["lower"]) == 8 and len(raw.facet_groups["bottom"][0]) == 4
    np.testing.assert_allclose(normals(raw, "bottom").sum(axis=0), [0, 0, -1])
    assert len(raw.node_groups["bottom"]) == 9
    for found, given in zip(
        facets_of_nodes(raw, raw.node_groups["bottom"]), raw.facet_groups["bottom"], strict=True
    ):
        np.testing.assert_array_equal(found, given)


def test_med(tmp_path):
    """MED numbers cells in the reverse sense; names come by families."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    mesh = meshio.Mesh(points, [("tetra", [[0, 2, 1, 3]]), ("triangle", [[0, 1, 2]])])
    mesh.cell_data["cell_tags"] = [np.array([-1]), np.array([-2])]
    mesh.cell_tags = {-1: ["body", "all"], -2: ["foot"]}
    mesh.point_data["point_tags"] = np.array([0, 0, 0, 3])
    mesh.point_tags = {3: ["tip"]}
    mesh.write(tmp_path / "m.med")
    raw = read_mesh(tmp_path / "m.med")
    assert volume(raw) == pytest.approx(1 / 6)
    assert {k: v.tolist() for k, v in raw.cell_groups.items()} == {"body": [0], "all": [0]}
    assert raw.node_groups["tip"].tolist() == [3]
    np.testing.assert_allclose(normals(raw, "foot"), [[0, 0, -0.5]])


def test_xdmf_and_medit(tmp_path):
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    cells = [("triangle", [[0, 1, 2], [0, 2, 3]])]
    meshio.Mesh(points, cells, cell_data={"medit:ref": [[4, 0]]}).write(tmp_path / "m.mesh")
    assert read_mesh(tmp_path / "m.mesh").cell_groups["surface_4"].tolist() == [0]
    meshio.Mesh(points, cells, cell_data={"gmsh:physical": [[4, 3]]}).write(
        tmp_path / "m.xdmf", data_format="XML"
    )
    assert read_mesh(tmp_path / "m.xdmf").cell_groups["surface_3"].tolist() == [1]


# --- what is refused

SQUARE = [(1, 0, 0, 0), (2, 1, 0, 0), (3, 1, 1, 0), (4, 0, 1, 0)]
HALVES = [(11, 2, 2, 1, 1, 1, 2, 3), (12, 2, 2, 1, 1, 1, 3, 4)]


def _text(folder, nodes, elements, name="bad.msh"):
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$Nodes", len(nodes)]
    lines += [" ".join(map(str, n)) for n in nodes] + ["$EndNodes", "$Elements", len(elements)]
    lines += [" ".join(map(str, e)) for e in elements] + ["$EndElements", ""]
    (folder / name).write_text("\n".join(map(str, lines)))
    return folder / name


@pytest.mark.parametrize(
    "nodes, elements, message",
    [
        (
            [*SQUARE[:2], (3, "nan", 1, 0), SQUARE[3]],
            HALVES,
            r"node 3 at \(nan, 1, 0\) has a coordinate that is not a finite number \(1 in all\)",
        ),
        (
            [*SQUARE[:2], (3, "inf", 1, 0), SQUARE[3]],
            HALVES,
            r"node 3 at \(inf, 1, 0\) has a coordinate that is not a finite number",
        ),
        ([*SQUARE[:2], (3, 1, 1, 0.5), SQUARE[3]], HALVES, "z goes from 0 to 0.5; .* a plane z = const"),
        ([*SQUARE, (4, 5, 6, 0)], HALVES, "a number that two nodes have"),
        (
            [*SQUARE[:3], (4, 0.9, 0.2, 0)],
            [HALVES[0], (12, 2, 2, 1, 1, 1, 3, 4)],
            r"cell 12 \(triangle at \(0.63.*, 0.4\)\) is inverted: it lies on the same side.*1 in",
        ),
        (SQUARE, [*HALVES, (13, 2, 2, 1, 1, 3, 1, 2)], "cell 13 has the same nodes as cell 11"),
        (
            SQUARE,
            [HALVES[0], (12, 2, 2, 1, 1, 1, 4, 4)],
            r"cell 12 \(triangle at .*\) is degenerate: it has node 4 more than once",
        ),
        ([(1, 0, 0, 0), (2, 1, 0, 0), (3, 3, 0, 0), (4, 0, 1, 0)], HALVES, "cell 11 .* has no volume"),
        (
            SQUARE,
            [(1, 1, 2, 5, 1, 1, 2), (2, 1, 2, 5, 1, 3, 4)],
            "the elements of the file are 2 of type line; allowed: cells of dimension 2 or 3",
        ),
        (SQUARE, [HALVES[0], (12, 2, 2, 1, 1, 1, 3, 77)], "element 12 refers to node 77"),
    ],
)
def test_refused(tmp_path, nodes, elements, message):
    path = _text(tmp_path, nodes, elements)
    with pytest.raises(InputError, match=message) as caught:
        read_mesh(path)
    check_line(caught.value, path)


def _damages(data, binary):
    """Damaged copies of a .msh file, by what was done to it."""
    at = {name: data.index(b"\n", data.index(b"$" + name)) + 1 for name in (b"Nodes", b"Elements")}
    for part in (0.1, 0.5, 0.9, 1.0 - 5 / len(data)):
        yield f"cut at {part}", data[: int(part * len(data))]
    for name, start in at.items():
        yield f"no {name}", data[: start - len(name) - 2] + data[data.index(b"$End" + name) + len(name) + 4 :]
        yield f"{name} twice", data + data[start - len(name) - 2 : data.index(b"$End" + name) + len(name) + 4] + b"\n"
        if data[12:13] == b"2":
            end = data.index(b"\n", start)
            counts = {"a count": (start, end, int(data[start:end]), lambda n: b"%d" % n)}
        elif binary:
            counts = {k: (start + 8 * k, start + 8 * k + 8, int.from_bytes(data[start + 8 * k :][:8], "little"),
                          lambda n: n.to_bytes(8, "little", signed=True)) for k in (0, 1)}  # fmt: skip
        else:
            end = data.index(b"\n", start)
            words = data[start:end].split()
            counts = {k: (start, end, int(words[k]), lambda n, k=k, words=words: b" ".join(
                [*words[:k], b"%d" % n, *words[k + 1 :]])) for k in (0, 1)}  # fmt: skip
        for key, (first, last, n, write) in counts.items():
            for other in (n - 1, n + 1, 0, -1, 1 << 50):
                yield f"{name} {key}: {other} for {n}", data[:first] + write(other) + data[last:]
    if binary:
        yield "bytes missing", data[: at[b"Elements"] + 40] + data[at[b"Elements"] + 43 :]
        yield "byte order", data.replace(b"\1\0\0\0\n$EndMesh", b"\1\1\1\1\n$EndMesh")
        return
    lines = data[at[b"Elements"] :].split(b"\n")
    longest = max(range(len(lines)), key=lambda k: len(lines[k].split()))
    words = lines[longest].split()
    for what, k, word in (("type", 1, b"199"), ("huge node", -1, b"99999999999999999999"), ("fraction", -1, b"1.5"),
                          ("word", -1, b"x"), ("negative", -1, b"-3"), ("missing", -1, b"")):  # fmt: skip
        if what == "type" and data[12:13] == b"4":
            continue
        row = b" ".join([*words[: k % len(words)], word, *words[k % len(words) + 1 :]])
        yield what, data[: at[b"Elements"]] + b"\n".join([*lines[:longest], row, *lines[longest + 1 :]])


@pytest.mark.parametrize("version, binary", FORMATS)
@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_damaged_gmsh_files(session, tmp_path, cell, version, binary):
    """Each ends in a line; gmsh crashes on some of them, and leaves out a part of others."""
    path = _write(tmp_path / "m.msh", cell, 1, 0, version, binary)
    read_mesh(path)
    done = 0
    for what, data in _damages(path.read_bytes(), binary):
        path.write_bytes(data)
        with pytest.raises(InputError) as caught:
            read_mesh(path)
            pytest.fail(what)
        check_line(caught.value, path)
        done += 1
    assert done > 15


@pytest.mark.parametrize(
    "name, content, message",
    [
        ("m.msh", None, "found no such file or directory"),
        ("m.msh", "", "not a gmsh mesh"),
        ("m.msh", 'SystemCall "touch hacked";', "not a gmsh mesh"),
        ("m.msh", "$MeshFormat\n4.0 0 8\n$EndMeshFormat\n$Nodes\nx\n$EndNodes\n", "gmsh cannot read it"),
        ("m.msh", "$MeshFormat\nfour 0 8\n$EndMeshFormat\n", "found 'four 0 8' after .* no version number"),
        ("m.msh", "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n", "holds no nodes"),
        (
            "m.msh",
            "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 4 1 4\n2 1 0 4\n1\n2\n",
            "found no .EndNodes: the file is cut short",
        ),
        ("m.geo", "Point(1) = {0, 0, 0};", 'unknown mesh file type ".geo"; allowed: .*.h5, .*.med, .*.vtu'),
        ("m.step", "ISO-10303-21;", "of a geometry, gmsh -3 -order 2 .*m.step -o .*m.msh makes a mesh"),
        ("m", "", 'unknown mesh file type ""'),
        ("m.vtu", "<VTKFile", "cannot be read as .vtu"),
        ("m.inp", "*NODE\n1, a\n", "cannot be read as .inp.* of a deck of Abaqus or CalculiX, pcontact import .*m.inp"),
        ("m.med", "nothing", "cannot be read as .med"),
        ("m.stl", "", "holds no nodes"),
    ],
)
def test_unreadable(tmp_path, name, content, message):
    path = tmp_path / name
    if content is not None:
        path.write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        read_mesh(path)
    check_line(caught.value, path)


@pytest.mark.parametrize(
    "cell, order, name", [("triangle", 3, "Triangle 10"), ("hexahedron", 3, "Hexahedron 64")]
)
def test_high_degree_is_refused(session, tmp_path, cell, order, name):
    with pytest.raises(InputError, match=f'"{name}"'):
        read_mesh(_write(tmp_path / "m.msh", cell, order))


def test_what_belongs_to_no_cell_is_left_out(session, tmp_path):
    """Nodes of no cell, with a warning; groups with such nodes or facets, which a scene can still ask for."""
    log.forget_warnings()
    points = np.array([[0, 0], [1, 0], [1, 1], [5, 5.0]])
    meshio.Mesh(points, [("triangle", [[0, 1, 2]])]).write(tmp_path / "m.vtu")
    assert len(read_mesh(tmp_path / "m.vtu").points) == 3
    # in version 4 a node of a surface, not of a geometric point
    path = _write(tmp_path / "m.msh", "triangle")
    gmsh.open(str(path))
    gmsh.model.mesh.addNodes(2, gmsh.model.getEntities(2)[0][1], [999], [5, 5, 0])
    gmsh.option.setNumber("Mesh.SaveAll", 1)
    gmsh.write(str(path))
    assert np.abs(read_mesh(path).points).max() < 3
    tip, diagonal, open_end = (15, 15, 2, 6, 6, 9), (13, 1, 2, 5, 1, 2, 4), (14, 1, 2, 7, 1, 3, 9)
    raw = read_mesh(_text(tmp_path, [*SQUARE, (8, 5, 6, 0), (9, 2, 2, 0)], [*HALVES, tip, diagonal, open_end]))
    assert len(raw.points) == 4 and not raw.facet_groups and not raw.node_groups
    lost = {"point_6": "node 9 at (2, 2, 0)", "curve_7": "node 9 at (2, 2, 0)", "curve_5": "facet 13 with nodes 2, 4"}
    assert raw.lost.keys() == lost.keys()
    assert all(raw.lost[name].startswith(who) and "(1 in all)" in raw.lost[name] for name, who in lost.items())
    said = log.warnings()
    for words in (r"m.vtu: node 4 at \(5, 5, 0\)", r"m.msh: node 999 at .*", r"bad.msh: node 8 at \(5, 6, 0\)"):
        assert sum(bool(re.search(words + ".*dimension 2", w)) for w in said) == 1, said


def test_a_tangled_quadratic_cell_is_refused(tmp_path):
    points = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0.7], [0.5, 0.5], [0, 0.5]])
    meshio.Mesh(points, [("triangle6", [[0, 1, 2, 3, 4, 5]])]).write(tmp_path / "m.vtu")
    with pytest.raises(InputError, match="cell 1 .*inverted.*Jacobian"):
        read_mesh(tmp_path / "m.vtu")


# --- completion


@pytest.mark.parametrize("cell", CELL_TYPES)
def test_complete(session, tmp_path, cell):
    raw = read_mesh(_write(tmp_path / "m.msh", cell))
    assert complete(raw, 1) is raw
    full = complete(raw, 2)
    assert [b.degree for b in full.blocks] == [2] and raw.blocks[0].degree == 1
    np.testing.assert_array_equal(full.points[: len(raw.points)], raw.points)
    np.testing.assert_array_equal(full.blocks[0].vertices, raw.blocks[0].nodes)
    check_straight(full)
    _check_groups(full, 2)
    assert len(np.unique(np.round(full.points, 9), axis=0)) == len(full.points)
    assert complete(full, 2) is full
    with pytest.raises(ValueError, match="degree 3"):
        complete(raw, 3)


@pytest.mark.parametrize("kind, cell", [("quad8", "quadrilateral"), ("hexahedron20", "hexahedron")])
def test_serendipity_cells_keep_their_own_interpolation(tmp_path, kind, cell):
    """A field of the serendipity space in the positions comes back exactly at the new nodes."""
    dim, n = CELLS[cell].dim, {"quad8": 8, "hexahedron20": 20}[kind]
    nodes = reference_nodes(cell, 2)

    def bend(x):
        square = x[:, :1] ** 2 * x[:, 1:2]  # in the span of 8 (20) nodes
        return x + 0.1 * square * np.arange(1, dim + 1) + 0.05 * np.roll(x, 1, axis=1) ** 2

    points = np.zeros((n, 3))
    points[:, :dim] = bend(nodes[:n])
    meshio.Mesh(points, [(kind, [np.arange(n)])]).write(tmp_path / "m.vtu")
    raw = read_mesh(tmp_path / "m.vtu")
    np.testing.assert_allclose(raw.points[raw.blocks[0].nodes[0]], bend(nodes), atol=1e-14)


def test_neighbours_of_different_degree_share_nodes():
    points = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.5, -0.2], [0.6, 0.6], [0, 0.5]])
    blocks = [
        Block("triangle", 1, np.array([[1, 3, 2]])),
        Block("triangle", 2, np.array([[0, 1, 2, 4, 5, 6]])),
    ]
    full = complete(RawMesh("m", 2, points, blocks), 2)
    assert len(full.points) == 9 and full.blocks[0].nodes[0].tolist()[5] == 5


def test_number_rows():
    rows = np.array([[3, 1], [2, 3], [1, 3], [0, 2], [3, 2]])
    first, number = number_rows(rows, 4)
    np.testing.assert_array_equal(number[[0, 1]], number[[2, 4]])
    assert len(first) == 3 and sorted(first) == [0, 1, 3]
    np.testing.assert_array_equal(number[first], np.arange(3))


def test_components():
    points = np.arange(20.0).reshape(10, 2)
    blocks = [
        Block("quadrilateral", 1, np.array([[6, 7, 8, 9]])),
        Block("triangle", 1, np.array([[3, 4, 5], [0, 1, 2], [9, 5, 3]])),
    ]
    np.testing.assert_array_equal(components(RawMesh("m", 2, points, blocks)), [0, 0, 1, 0])
