"""Universal files, which gmsh translates, with their groups; what gmsh must not run."""

import numpy as np
import pytest

from pcontact.mesh.geometry.belonging import opened
from pcontact.mesh.read import read_mesh
from pcontact.runtime.errors import InputError

# two bricks on each other, with the lower face of the first one and the upper face of the second one
POINTS = np.array([[x, y, z] for z in range(3) for y in range(2) for x in range(2)], dtype=float)
BRICKS = np.array([[0, 1, 3, 2, 4, 5, 7, 6], [4, 5, 7, 6, 8, 9, 11, 10]])
FACES = np.array([[0, 2, 3, 1], [8, 9, 11, 10]])


def unv(path):
    """The bricks as a universal file: nodes (2411), elements (2412), groups (2467)."""
    lines = ["    -1", "  2411"]
    for k, point in enumerate(POINTS, 1):
        lines += [f"{k:10d}{1:10d}{1:10d}{11:10d}", "".join(f"{x:25.16E}" for x in point)]
    lines += ["    -1", "    -1", "  2412"]
    rows = [(115, nodes) for nodes in BRICKS] + [(94, nodes) for nodes in FACES]
    for k, (kind, nodes) in enumerate(rows, 1):
        lines += [f"{k:10d}{kind:10d}{0:10d}{0:10d}{7:10d}{len(nodes):10d}", "".join(f"{n + 1:10d}" for n in nodes)]
    lines += ["    -1", "    -1", "  2467"]
    for number, name in enumerate(("lower", "upper", "foot", "top"), 1):
        lines += [f"{number:10d}" + 6 * f"{0:10d}" + f"{1:10d}", name, f"{8:10d}{number:10d}{0:10d}{0:10d}"]
    path.write_text("\n".join([*lines, "    -1", ""]))


def test_groups_of_universal_files(tmp_path):
    pytest.importorskip("gmsh")
    unv(tmp_path / "m.unv")
    raw = read_mesh(tmp_path / "m.unv")
    assert {name: cells.tolist() for name, cells in raw.cell_groups.items()} == {"lower": [0], "upper": [1]}
    assert {name: rows[0].tolist() for name, rows in raw.facet_groups.items()} == {"foot": [0], "top": [1]}
    assert np.ptp(raw.points, axis=0).tolist() == [1.0, 1.0, 2.0]


def test_damaged_universal_files_are_refused(tmp_path):
    (tmp_path / "m.unv").write_text("    -1\n  2411\nnothing\n")
    with pytest.raises(InputError, match=r"m\.unv.*allowed"):
        read_mesh(tmp_path / "m.unv")


def script(folder):
    """A script of gmsh, and the file that it makes where it is run."""
    return f'SystemCall "touch {folder / "ran"}";\n', folder / "ran"


@pytest.mark.parametrize("name", ["m.Unv", "m.unv", "m.msh", "m.Step", "m.brep"])
def test_scripts_by_another_name_are_not_run(tmp_path, name):
    pytest.importorskip("gmsh")
    text, ran = script(tmp_path)
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError):
        if name.lower().endswith(("step", "brep")):
            with opened(tmp_path / name, 3):
                pass
        read_mesh(tmp_path / name)
    assert not ran.exists()


def test_options_beside_files_are_not_run(tmp_path, session):
    text, ran = script(tmp_path)
    gmsh = pytest.importorskip("gmsh")
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.write(str(tmp_path / "m.brep"))
    (tmp_path / "m.brep.opt").write_text(text)
    with opened(tmp_path / "m.brep", 3) as drawing:
        assert len(drawing.boundary) == 6
    assert not ran.exists()


def test_modules_beside_scenes_are_not_run(tmp_path, monkeypatch):
    pytest.importorskip("gmsh")
    unv(tmp_path / "m.unv")
    (tmp_path / "gmsh.py").write_text("raise SystemExit('ran')\n")
    monkeypatch.chdir(tmp_path)
    assert read_mesh(tmp_path / "m.unv").dim == 3
