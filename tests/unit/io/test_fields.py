"""The files a run leaves: fields, history, report, and the fields read back."""

import base64
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
from mpi4py import MPI

import pcontact as pc
from pcontact.io import vtu
from pcontact.io.fields import FieldWriter, Piece, grid_of
from pcontact.io.names import FIELDS, known
from pcontact.io.result import load_result
from pcontact.io.snapshot import facet_status
from pcontact.runtime.errors import InputError
from pcontact.scene.reader import read_scene
from pcontact.simulation import Simulation
from tests.support.bad_input import FACETS, SCENE, mesh_text
from tests.support.pieces import CUBE, stack_piece, stretch

COMM = MPI.COMM_WORLD


def square_piece(shift=0.0):
    """Two dimensions: a quadrilateral and a triangle, second order."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0], [1, 0.5], [0.5, 1], [0, 0.5], [0.5, 0.5],
                       [2, 0], [1.5, 0], [1.5, 0.5]]) + [shift, 0]  # fmt: skip
    cells = [("quad9", np.arange(9).reshape(1, 9)), ("triangle6", np.array([[1, 9, 2, 10, 11, 5]]))]
    return Piece(
        points,
        cells,
        {"displacement": 0.1 * points},
        {"equivalent_stress": [np.array([1.0]), np.array([2.0])]},
    )


@pytest.mark.parallel
def test_fields_are_read_back_whole_from_all_ranks(shared_tmp):
    writer = FieldWriter(shared_tmp, COMM)
    surface = Piece(
        CUBE[:4] + [0, 0, COMM.rank],
        [("quad", [[0, 1, 2, 3]])],
        {},
        {"contact_pressure": [[1.0 + COMM.rank]]},
    )
    cloud = Piece(np.full((COMM.rank + 1, 3), float(COMM.rank)), [], {"pressure": np.arange(COMM.rank + 1.0)})
    for step, time in ((1, 0.5), (2, 1.0)):
        writer.write(step, time, stack_piece(COMM.rank), {"ball / block": surface}, {"ball / block": cloud})
    result = load_result(shared_tmp)
    assert result.times == [0.5, 1.0] and result.time == 1.0
    bodies = result.bodies
    assert len(bodies.points) == 5 + 7 * COMM.size, "the layers of nodes between ranks are joined"
    np.testing.assert_array_equal(bodies.point_data["displacement"], stretch(bodies.points))
    kinds = dict(bodies.cells)
    order = list(kinds)
    ranks = bodies.cell_data["rank"][order.index("hexahedron")]
    np.testing.assert_array_equal(ranks, np.arange(COMM.size))
    np.testing.assert_array_equal(bodies.points[kinds["hexahedron"][-1]], CUBE + [0, 0, COMM.size - 1])
    np.testing.assert_array_equal(
        bodies.cell_data["stress"][order.index("tetra")][:, 5], 105 + 10 * np.arange(COMM.size)
    )
    np.testing.assert_array_equal(
        result.surfaces["ball / block"].cell_data["contact_pressure"][0], 1.0 + np.arange(COMM.size)
    )
    assert len(result.points["ball / block"].points) == COMM.size * (COMM.size + 1) // 2
    assert load_result(shared_tmp, 1).time == 0.5
    assert not list(shared_tmp.rglob("*.part"))


@pytest.mark.parallel
def test_ranks_without_cells_keep_the_arrays_consistent(shared_tmp):
    last = COMM.size - 1
    own = COMM.rank != last or COMM.size == 1
    surfaces = (
        {"pair": Piece(CUBE[:4], [("quad", [[0, 1, 2, 3]])], {}, {"gap": [[0.5]]})}
        if COMM.rank == last
        else {}
    )
    nowhere = Piece(np.zeros((0, 2)), [], {"traction": np.zeros((0, 2)), "status": np.zeros(0, dtype=np.int64)})
    bodies = (
        stack_piece(COMM.rank) if own else Piece(np.zeros((0, 3)), [], {"displacement": np.zeros((0, 3))})
    )
    FieldWriter(shared_tmp, COMM).write(1, 1.0, bodies, surfaces, {"pair": nowhere})
    result = load_result(shared_tmp)
    assert sum(len(nodes) for _, nodes in result.bodies.cells) == 2 * max(last, 1)
    assert result.surfaces["pair"].cell_data["gap"][0] == 0.5
    assert result.points["pair"].point_data["traction"].shape == (0, 3)
    assert result.points["pair"].point_data["status"].dtype == np.int64
    for index in (shared_tmp / "fields").glob("*.pvtu"):
        root = ElementTree.parse(index).getroot()
        for section in ("PointData", "CellData"):
            declared = [
                (a.get("Name"), a.get("type"), a.get("NumberOfComponents"))
                for a in root.find(f".//P{section}")
            ]
            for piece in vtu.read_pvtu(index):
                arrays = ElementTree.parse(piece).getroot().find(f".//{section}")
                assert [
                    (a.get("Name"), a.get("type"), a.get("NumberOfComponents")) for a in arrays
                ] == declared


@pytest.mark.parallel
def test_what_is_wrong_on_one_rank_is_raised_on_all(shared_tmp):
    piece = stack_piece(COMM.rank)
    if COMM.rank == COMM.size - 1:
        piece.point_data["displacement"] = piece.point_data["displacement"][1:]
    with pytest.raises(ValueError, match="displacement"):
        FieldWriter(shared_tmp, COMM).write(1, 1.0, piece)


@pytest.mark.parallel
def test_a_resumed_run_keeps_the_steps_before_it(shared_tmp):
    first = FieldWriter(shared_tmp, COMM)
    index = []
    for step in (1, 2, 3):
        first.write(step, 0.1 * step, stack_piece(COMM.rank))
        COMM.barrier()
        index.append((shared_tmp / "fields.pvd").stat().st_ino)
        assert load_result(shared_tmp).times == pytest.approx(0.1 * np.arange(1, step + 1))
        COMM.barrier()
    assert len(set(index)) == 1, "the index of a long run is added to, not written again"
    FieldWriter(shared_tmp, COMM, resume_time=0.2).write(3, 0.25, stack_piece(COMM.rank))
    assert load_result(shared_tmp).times == pytest.approx([0.1, 0.2, 0.25])
    COMM.barrier()
    FieldWriter(shared_tmp, COMM).write(1, 7.0, stack_piece(COMM.rank))
    assert load_result(shared_tmp).times == [7.0]
    assert len(list((shared_tmp / "fields").iterdir())) == COMM.size + 1, (
        "a fresh run clears away the old files"
    )


def test_meshio_reads_the_pieces(tmp_path):
    FieldWriter(tmp_path, MPI.COMM_SELF).write(1, 1.0, square_piece())
    mesh = meshio.read(tmp_path / "fields" / "bodies_000001_0000.vtu")
    piece = square_piece()
    np.testing.assert_array_equal(mesh.points, np.pad(piece.points, ((0, 0), (0, 1))))
    assert {block.type: block.data.tolist() for block in mesh.cells} == {
        k: np.asarray(n).tolist() for k, n in piece.cells
    }
    np.testing.assert_array_equal(mesh.point_data["displacement"][:, :2], piece.point_data["displacement"])
    assert mesh.point_data["displacement"].shape == (12, 3)
    assert [float(values[0]) for values in mesh.cell_data["equivalent_stress"]] == [1.0, 2.0]


def some_grid(random):
    """A piece with some triangles and quadrilaterals, and fields of all kinds."""
    n, counts = int(random.integers(4, 40)), random.integers(0, 12, 2)
    cells = [(kind, random.integers(0, n, (count, nodes))) for kind, count, nodes in
             zip(("triangle", "quad"), counts, (3, 4), strict=True) if count]  # fmt: skip
    points = {"displacement": random.normal(size=(n, 3)), "node_number": np.arange(n)}
    fields = {"stress": 6, "status": 1, "weight": 1}
    values = {name: [random.normal(size=(len(nodes), k)) if k > 1 else random.integers(0, 3, len(nodes)) * 1.0
                     for _, nodes in cells] for name, k in fields.items()}  # fmt: skip
    return Piece(random.normal(size=(n, 3)), cells, points, values)


def test_meshio_reads_two_hundred_files(tmp_path):
    """Of one in some twenty it finds wrong arrays where data stand behind the XML: compressed sizes add up badly."""
    random = np.random.default_rng(0)
    for number in range(200):
        piece, path = some_grid(random), tmp_path / f"{number}.vtu"
        grid = grid_of(piece)
        vtu.write_vtu(path, grid)
        again = vtu.read_vtu(path)
        for name in ("points", "connectivity", "offsets", "types"):
            np.testing.assert_array_equal(getattr(again, name), getattr(grid, name))
        if not piece.cells:
            # of no cells meshio makes no mesh
            continue
        mesh = meshio.read(path)
        np.testing.assert_array_equal(mesh.points, piece.points)
        for name, array in piece.point_data.items():
            np.testing.assert_array_equal(mesh.point_data[name].reshape(array.shape), array)
            np.testing.assert_array_equal(again.point_data[name], array)
        assert [block.type for block in mesh.cells] == [kind for kind, _ in piece.cells]
        for k, (_, nodes) in enumerate(piece.cells):
            np.testing.assert_array_equal(mesh.cells[k].data, nodes)
            for name, arrays in piece.cell_data.items():
                np.testing.assert_array_equal(mesh.cell_data[name][k].reshape(arrays[k].shape), arrays[k])


def appended(path):
    """Write a piece of a file as older versions of the program did: its arrays raw, behind the XML."""
    root, data = ElementTree.parse(path).getroot(), b""
    for tag in root.iter("DataArray"):
        text = tag.text.strip()
        tag.text = None
        tag.set("format", "appended")
        tag.set("offset", str(len(data)))
        data += base64.b64decode(text[:44]) + base64.b64decode(text[44:]) if text else bytes(24)
    head = ElementTree.tostring(root).replace(b"</VTKFile>", b'<AppendedData encoding="raw">\n_')
    path.write_bytes(head + data + b"\n</AppendedData>\n</VTKFile>\n")


def test_fields_of_older_versions_are_read(tmp_path):
    writer = FieldWriter(tmp_path, MPI.COMM_SELF)
    writer.write(1, 1.0, stack_piece(0), {}, {"p": Piece(np.zeros((0, 3)), [], {"gap": np.zeros(0)})})
    now = load_result(tmp_path)
    for path in (tmp_path / "fields").glob("*.vtu"):
        appended(path)
    then = load_result(tmp_path)
    np.testing.assert_array_equal(then.bodies.points, now.bodies.points)
    np.testing.assert_array_equal(then.bodies.point_data["displacement"], now.bodies.point_data["displacement"])
    for name, arrays in now.bodies.cell_data.items():
        for one, other in zip(arrays, then.bodies.cell_data[name], strict=True):
            np.testing.assert_array_equal(one, other)
    assert then.points["p"].point_data["gap"].shape == (0,)


def test_vtk_reads_the_fields(tmp_path):
    """Against ParaView's own reader, where it is installed."""
    vtk = pytest.importorskip("vtk")
    FieldWriter(tmp_path, MPI.COMM_SELF).write(1, 1.0, stack_piece(2), {}, {"p": Piece(np.zeros((0, 3)))})
    reader = vtk.vtkXMLPUnstructuredGridReader()
    for name, cells in (("bodies", 2), ("points_p", 0)):
        reader.SetFileName(str(tmp_path / "fields" / f"{name}_000001.pvtu"))
        reader.Update()
        assert reader.GetErrorCode() == 0 and reader.GetOutput().GetNumberOfCells() == cells


def test_cells_with_nodes_beyond_the_points_are_refused(tmp_path):
    with pytest.raises(ValueError, match="beyond"):
        FieldWriter(tmp_path, MPI.COMM_SELF).write(1, 1.0, Piece(CUBE[:3], [("tetra", [[0, 1, 2, 3]])]))
    with pytest.raises(ValueError, match="type 'blob'"):
        FieldWriter(tmp_path, MPI.COMM_SELF).write(1, 1.0, Piece(CUBE, [("blob", [[0, 1, 2, 3]])]))
    assert not list(tmp_path.iterdir()), "nothing is written of a step that is refused"


def test_reading_names_what_is_missing(tmp_path):
    with pytest.raises(InputError, match="no such directory"):
        load_result(tmp_path / "nowhere")
    with pytest.raises(InputError, match="no fields.pvd or fields.vtkhdf"):
        load_result(tmp_path)
    FieldWriter(tmp_path, MPI.COMM_SELF).write(1, 1.0, square_piece())
    with pytest.raises(InputError, match="no step 3"):
        load_result(tmp_path, 3)
    (tmp_path / "fields" / "bodies_000001_0000.vtu").unlink()
    with pytest.raises(InputError, match="cannot be read"):
        load_result(tmp_path)


TOUCHING = """\
[mesh]
file = "mesh.msh"
order = ORDER
[materials.m]
E = 1000.0
nu = 0.3
[[bodies]]
region = "lower"
material = "m"
[[contacts]]
source = "upper_bottom"
target = "lower_top"
[[displacements]]
region = "lower_bottom"
value = [0.0, 0.0]
[[displacements]]
region = "upper_top"
value = [0.0, 0.25]
[output]
smooth = SMOOTH
format = "FORMAT"
"""


@pytest.mark.parallel
@pytest.mark.parametrize("order, smooth, kind", [(1, "false", "vtkhdf"), (2, "true", "vtu")])
def test_touching_bodies_of_one_region_stay_apart(shared_tmp, order, smooth, kind):
    """Their nodes are in the same place; each body keeps its own displacement."""
    if COMM.rank == 0:
        squares = [(3, 1, (1, 2, 3, 4)), (3, 1, (5, 6, 7, 8)), *FACETS]
        (shared_tmp / "mesh.msh").write_text(mesh_text(elements=squares))
        text = TOUCHING.replace("ORDER", str(order)).replace("SMOOTH", smooth).replace("FORMAT", kind)
        (shared_tmp / "scene.toml").write_text(text)
    COMM.barrier()
    simulation = Simulation(read_scene(shared_tmp / "scene.toml"))
    assert simulation.run(shared_tmp / "run")
    simulation.close()
    assert (shared_tmp / "run" / "fields.vtkhdf.series").exists() == (kind == "vtkhdf")
    bodies = load_result(shared_tmp / "run").bodies
    assert len(bodies.points) == 2 * (order + 1) ** 2 and "node_number" not in bodies.point_data
    middle = np.abs(bodies.points[:, 1] - 1.0) < 1e-9
    np.testing.assert_allclose(
        np.sort(bodies.point_data["displacement"][middle, 1]), np.repeat([0.0, 0.25], order + 1), atol=1e-6
    )
    _moved_and_undeformed(shared_tmp / "run", order)


def _moved_and_undeformed(run, order):
    """Contact surfaces have their own points; these and quadrature points move with the bodies; step 0 is time 0."""
    last, begin = load_result(run), load_result(run, 0)
    assert last.times == begin.times == [0.5, 1.0] and (begin.time, last.time) == (0.0, 1.0)
    assert len(pc.load(run, 0).fields().points) == 2 * (order + 1) ** 2 and pc.load(run).fields().number == 2
    for result, motion in ((last, 0.25), (begin, 0.0)):
        (surface,), (cloud,) = result.surfaces.values(), result.points.values()
        # one facet, of the upper body
        assert len(surface.points) == order + 1 and surface.cells[0][1].max() == order
        for piece, data in ((surface, surface.point_data), (cloud, cloud.point_data)):
            np.testing.assert_allclose(data["displacement"], [[0.0, motion, 0.0]] * len(piece.points), atol=1e-6)
        np.testing.assert_allclose(cloud.point_data["gap"], motion, atol=1e-6)
        assert np.abs(result.bodies.point_data["displacement"]).max() == pytest.approx(motion, abs=1e-6)
    assert not np.concatenate(begin.bodies.cell_data["stress"]).any()
    with pytest.raises(InputError, match="no step 3; allowed: 1 to 2, or -1 .the last. to -2; 0: undeformed"):
        load_result(run, 3)


def test_status_of_facets():
    """By area: open, stick, slip; a facet whose edge alone is closed; one in which sliding points have more area."""
    facet = np.array([0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4])
    status = np.array([0, 0, 1, 1, 2, 2, 0, 1, 1, 1, 2])
    weight = np.array([1, 1, 1, 1, 1, 1, 9, 1, 1, 1, 3.0])
    assert facet_status(facet, status, weight, 6).tolist() == [0, 1, 2, 1, 2, 0]


@pytest.mark.parametrize("more", [
    {"materials": {"m": {"yield_stress": 20.0, "hardening": 100.0}}, "output": {"smooth": True, "estimate": True}},
    {"mesh": {"strain": "finite"}, "contacts": {"0": {"friction": 0.1}}, "output": {"slip": True},
     "dynamics": {"alpha": -0.1}, "materials": {"m": {"density": 1.0}}},
])  # fmt: skip
def test_all_fields_are_declared(more, tmp_path):
    """What a run writes is in the table, at its place; and the table has nothing that neither of two runs has."""
    (tmp_path / "mesh.msh").write_text(mesh_text())
    (tmp_path / "scene.toml").write_text(SCENE)
    run = pc.run(pc.read(tmp_path / "scene.toml", **more), output=tmp_path / "out")
    assert run.converged
    result = load_result(tmp_path / "out", -1)
    # who reads the pieces of several ranks puts them together by these numbers, and keeps none of them
    found = {("nodes", name) for name in [*result.bodies.point_data, "node_number"]}
    found |= {("cells", name) for name in result.bodies.cell_data}
    for piece in result.surfaces.values():
        found |= {("facets", name) for name in piece.cell_data}
    for cloud in result.points.values():
        found |= {("points", name) for name in cloud.point_data}
    assert found <= {(field.place, field.name) for field in FIELDS}
    without = {"a body may yield", "`smooth = true`", "`estimate = true`"}
    without = without if "mesh" in more else {"finite strain", "`slip = true`", "`[dynamics]`"}
    wanted = {(field.place, field.name) for field in FIELDS if not without & set(field.when.split(", "))}
    assert wanted <= found


def test_names_of_pictures():
    assert known("stress_xy") and known("stretch_1") and known("displacement") and not known("stress_q")
