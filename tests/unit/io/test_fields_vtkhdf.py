"""Fields of a load step in one file: the same as in pieces, with links to a mesh that stays, whole, read by VTK."""

import h5py
import numpy as np
import pytest
from mpi4py import MPI

from pcontact.io import vtu
from pcontact.io.fields import FieldWriter, Piece
from pcontact.io.result import load_result
from pcontact.runtime.errors import InputError, OutputError
from tests.support.disk import full
from tests.support.pieces import CUBE, stack_piece

COMM = MPI.COMM_WORLD
parallel = pytest.mark.parallel


def hdf_writer(directory, comm, resume_time=None, compression=0):
    """Writer of one file for each load step."""
    return FieldWriter(directory, comm, resume_time, "vtkhdf", compression)


def fields(step, rank=COMM.rank):
    """Bodies, and a contact that acts in the load steps 2 and 3."""
    bodies = stack_piece(rank)
    bodies.point_data["displacement"] = step * bodies.point_data["displacement"]
    facet = Piece(CUBE[:4] + [0, 0, rank], [("quad", [[0, 1, 2, 3]])], {}, {"contact_pressure": [[1.0 + rank + step]]})
    cloud = Piece(np.full((rank + 1, 3), float(rank)), [], {"pressure": step + np.arange(rank + 1.0)})
    acts = step in (2, 3)
    return bodies, {"a / b": facet} if acts else {}, {"a / b": cloud} if acts else {}


def same(one, other):
    """Two results of a load step are the same."""
    assert one.time == other.time and one.times == other.times
    assert one.surfaces.keys() == other.surfaces.keys() and one.points.keys() == other.points.keys()
    pairs = [(one.bodies, other.bodies)] + [(one.surfaces[k], other.surfaces[k]) for k in one.surfaces]
    for a, b in pairs:
        assert [kind for kind, _ in a.cells] == [kind for kind, _ in b.cells]
        for (_, mine), (_, theirs) in zip(a.cells, b.cells, strict=True):
            np.testing.assert_array_equal(mine, theirs)
        assert a.point_data.keys() == b.point_data.keys() and a.cell_data.keys() == b.cell_data.keys()
        for name in a.point_data:
            np.testing.assert_array_equal(a.point_data[name], b.point_data[name], err_msg=name)
        for name in a.cell_data:
            for mine, theirs in zip(a.cell_data[name], b.cell_data[name], strict=True):
                np.testing.assert_array_equal(mine, theirs, err_msg=name)
    for name, cloud in one.points.items():
        np.testing.assert_array_equal(cloud.point_data["pressure"], other.points[name].point_data["pressure"])


@parallel
@pytest.mark.parametrize("compression", [0, 4])
def test_the_same_as_in_pieces(shared_tmp, compression):
    hdf = hdf_writer(shared_tmp / "hdf", COMM, compression=compression)
    pieces = FieldWriter(shared_tmp / "vtu", COMM)
    for step in (1, 2, 3, 4):
        for writer in (hdf, pieces):
            writer.write(step, 0.25 * step, *fields(step))
    for step in (1, 2, 3, 4):
        same(load_result(shared_tmp / "hdf", step), load_result(shared_tmp / "vtu", step))
    folder = shared_tmp / "hdf" / "fields"
    assert sorted(p.name for p in folder.iterdir()) == [f"step_{k:06d}.vtkhdf" for k in (1, 2, 3, 4)]
    for step in (1, 2, 3, 4):
        with h5py.File(folder / f"step_{step:06d}.vtkhdf", "r") as file:
            bodies = file["VTKHDF/bodies"]
            linked = isinstance(bodies.get("Points", getlink=True), h5py.ExternalLink)
            assert linked == (step > 1) and len(bodies["Points"]) == 12 * COMM.size, "the mesh is written once"
            assert len(bodies["PointData/displacement"]) == 12 * COMM.size
            assert bodies["PointData/displacement"].compression == ("gzip" if compression else None)


@parallel
def test_a_mesh_that_changes_is_written_again(shared_tmp):
    """On one rank alone, and back to the one of before."""
    hdf, pieces = hdf_writer(shared_tmp / "hdf", COMM), FieldWriter(shared_tmp / "vtu", COMM)
    for step in (1, 2, 3, 4):
        bodies, surfaces, points = fields(step)
        if step == 3 and COMM.rank == COMM.size - 1:
            bodies.points = bodies.points + 1.0
        for writer in (hdf, pieces):
            writer.write(step, step, bodies, surfaces, points)
    for step in (1, 2, 3, 4):
        same(load_result(shared_tmp / "hdf", step), load_result(shared_tmp / "vtu", step))


@parallel
def test_rows_in_several_chunks(shared_tmp, monkeypatch):
    """Rows of a rank begin and end within chunks that it shares with other ranks."""
    monkeypatch.setattr("pcontact.runtime.parallel.CHUNK", 2 * 24)
    hdf, pieces = hdf_writer(shared_tmp / "hdf", COMM, None, 4), FieldWriter(shared_tmp / "vtu", COMM)
    for step in (1, 2, 3):
        for writer in (hdf, pieces):
            writer.write(step, step, *fields(step))
    for step in (1, 2, 3):
        same(load_result(shared_tmp / "hdf", step), load_result(shared_tmp / "vtu", step))


@parallel
@pytest.mark.parametrize("kept", [1, 2, 3])
def test_a_resumed_run_appends(shared_tmp, kept):
    whole, first = hdf_writer(shared_tmp / "whole", COMM), hdf_writer(shared_tmp / "part", COMM)
    for step in (1, 2, 3):
        whole.write(step, step, *fields(step))
        first.write(step, step, *fields(step) if step <= kept else fields(7))
    again = hdf_writer(shared_tmp / "part", COMM, resume_time=float(kept))
    for step in range(kept + 1, 5):
        again.write(step, step, *fields(step))
    whole.write(4, 4, *fields(4))
    for step in (1, 2, 3, 4):
        same(load_result(shared_tmp / "part", step), load_result(shared_tmp / "whole", step))
    COMM.Barrier()
    hdf_writer(shared_tmp / "part", COMM).write(1, 9.0, *fields(1))
    assert load_result(shared_tmp / "part").times == [9.0], "a fresh run begins a new file"


@parallel
@pytest.mark.parametrize("compression", [0, 4])
def test_a_run_on_other_ranks_goes_on(shared_tmp, compression):
    """Written by one rank, maybe compressed; gone on with by all, without compression."""
    if COMM.rank == 0:
        alone = hdf_writer(shared_tmp, MPI.COMM_SELF, compression=compression)
        for step in (1, 2):
            alone.write(step, step, *fields(step, 0))
    COMM.Barrier()
    hdf_writer(shared_tmp, COMM, resume_time=2.0).write(3, 3.0, *fields(3))
    pieces = FieldWriter(shared_tmp / "vtu", COMM)
    pieces.write(3, 3.0, *fields(3))
    found, wanted = load_result(shared_tmp), load_result(shared_tmp / "vtu")
    assert found.times == [1.0, 2.0, 3.0]
    found.times = wanted.times
    same(found, wanted)
    assert len(load_result(shared_tmp, 2).bodies.points) == 12


@parallel
def test_one_format_at_a_time(shared_tmp):
    FieldWriter(shared_tmp, COMM).write(1, 1.0, *fields(1))
    with pytest.raises(InputError, match="fields.pvd: found fields of the other format"):
        hdf_writer(shared_tmp, COMM, resume_time=1.0)
    hdf_writer(shared_tmp, COMM).write(1, 2.0, *fields(1))
    assert not (shared_tmp / "fields.pvd").exists() and load_result(shared_tmp).time == 2.0
    COMM.Barrier()
    with pytest.raises(InputError, match="fields.vtkhdf.series: found fields of the other format"):
        FieldWriter(shared_tmp, COMM, resume_time=1.0)
    FieldWriter(shared_tmp, COMM).write(1, 3.0, *fields(1))
    assert not (shared_tmp / "fields.vtkhdf.series").exists() and load_result(shared_tmp).time == 3.0


@parallel
@pytest.mark.parametrize("compression", [0, 4])
def test_a_full_disk_leaves_the_file_of_before(shared_tmp, compression):
    """Whichever rank meets it."""
    writer = hdf_writer(shared_tmp, COMM, compression=compression)
    writer.write(1, 1.0, *fields(1))
    COMM.Barrier()
    with full(500), pytest.raises(OutputError, match="step_000002.vtkhdf: cannot be written"):
        writer.write(2, 2.0, *fields(2))
    assert load_result(shared_tmp).times == [1.0]
    COMM.Barrier()
    writer.write(2, 2.0, *fields(2))
    assert load_result(shared_tmp).times == [1.0, 2.0]


def test_a_run_that_is_killed_while_it_writes(tmp_path, monkeypatch):
    """Before a load step is entered: a reader and the next run have those of before."""
    def killed(*_):
        raise KeyboardInterrupt

    writer = hdf_writer(tmp_path, MPI.COMM_SELF)
    for step in (1, 2):
        writer.write(step, step, *fields(step))
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(vtu, "add_to_index", killed)
        writer.write(3, 3.0, *fields(3))
    assert load_result(tmp_path).times == [1.0, 2.0]
    hdf_writer(tmp_path, MPI.COMM_SELF, resume_time=2.0).write(3, 3.5, *fields(3))
    assert load_result(tmp_path).times == [1.0, 2.0, 3.5]


def test_what_is_no_such_file_is_named(tmp_path):
    (tmp_path / "fields.vtkhdf.series").write_bytes(b"nothing")
    with pytest.raises(InputError, match="fields.vtkhdf.series: the fields cannot be read"):
        load_result(tmp_path)
    with pytest.raises(InputError, match="fields.vtkhdf.series: found what cannot be read"):
        hdf_writer(tmp_path, MPI.COMM_SELF, resume_time=1.0)
    hdf_writer(tmp_path, MPI.COMM_SELF).write(1, 2.0, *fields(1))
    (tmp_path / "fields" / "step_000001.vtkhdf").write_bytes(b"nothing")
    with pytest.raises(InputError, match="fields.vtkhdf.series: the fields cannot be read"):
        load_result(tmp_path)


@parallel
def test_vtk_reads_the_series(shared_tmp):
    """ParaView's own reader, where it is installed, and pyvista."""
    pyvista, hdf = pytest.importorskip("pyvista"), pytest.importorskip("vtkmodules.vtkIOHDF")
    writer = hdf_writer(shared_tmp, COMM)
    for step in (1, 2, 3, 4):
        writer.write(step, 0.25 * step, *fields(step))
    for step in (4, 2, 1, 3):
        reader = hdf.vtkHDFReader()
        reader.SetFileName(str(shared_tmp / "fields" / f"step_{step:06d}.vtkhdf"))
        reader.Update()
        blocks, pieces = pyvista.wrap(reader.GetOutputDataObject(0)), [fields(step, rank) for rank in range(COMM.size)]
        assert blocks.keys() == ["bodies", "surface_a_b", "points_a_b"][: 3 if step in (2, 3) else 1]
        bodies = blocks["bodies"]
        np.testing.assert_array_equal(bodies.points, np.concatenate([one.points for one, _, _ in pieces]))
        np.testing.assert_array_equal(
            bodies["displacement"], np.concatenate([one.point_data["displacement"] for one, _, _ in pieces])
        )
        assert bodies.celltypes.tolist() == [12, 10] * COMM.size
        assert bodies.get_cell(2 * COMM.size - 1).point_ids == list(range(12 * COMM.size - 4, 12 * COMM.size))
        if step in (2, 3):
            wanted = [1.0 + rank + step for rank in range(COMM.size)]
            assert blocks["surface_a_b"].cell_data["contact_pressure"].tolist() == wanted
    assert pyvista.read(shared_tmp / "fields" / "step_000002.vtkhdf").keys()[0] == "bodies"
