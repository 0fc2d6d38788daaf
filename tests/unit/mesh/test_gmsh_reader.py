"""Universal files, which gmsh translates, with their groups."""

import numpy as np
import pytest

from pcontact.mesh.reader import read_mesh
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
