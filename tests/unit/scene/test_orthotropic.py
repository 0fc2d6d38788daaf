"""Orthotropic materials of a scene: what is refused, and with which words."""

import numpy as np
import pytest

from pcontact.runtime.errors import InputError
from pcontact.scene.model import Body, Material, MeshSpec, Scene
from pcontact.scene.orthotropic import equivalent_poisson, indefinite
from pcontact.scene.regions import check_dimension
from pcontact.scene.validate import validate
from tests.support.orthotropic import LAMINATE, WOOD, isotropic

GOOD = {"E": WOOD[0], "nu": WOOD[1], "G": WOOD[2]}


def scene(folder, mesh=None, **material):
    (folder / "m.msh").write_text("")
    return Scene(
        MeshSpec("m.msh", **(mesh or {})), {"m": Material(**{**GOOD, **material})}, [Body("block", "m")],
        beside=folder,
    )  # fmt: skip


@pytest.mark.parametrize("said, key, found, allowed", [
    ({"E": 3.0}, "nu", r"a list \[0.37, 0.42, 0.47\] without Young's moduli", r"E = \[E1, E2, E3\]"),
    ({"E": 3.0, "nu": 0.3}, "G", "without Young's moduli", r"E = \[E1, E2, E3\]"),
    ({"E": 3.0, "nu": 0.3, "G": None, "angle": 3}, "angle", "3.0 without Young's moduli", r"E = \[E1"),
    ({"E": 3.0, "nu": 0.3, "G": None, "expansion": [1, 2, 3]}, "expansion", "without Young's moduli", r"E = \[E1"),
    ({"E": [1, 2]}, "E", "2 entries", "a list of 3 such numbers"),
    ({"E": [1, 2, -3]}, "E", "entry 2 is an integer -3", "a number > 0"),
    ({"nu": 0.3}, "nu", "a number 0.3 together with E of three axes", "a list of 3 numbers, nu12"),
    ({"G": None}, "G", "nothing together with E of three axes", "G12, G13, G23"),
    ({"G": [1, 2, 0]}, "G", "entry 2 is an integer 0", "numbers > 0"),
    ({"expansion": 1e-5}, "expansion", "together with E of three axes", "a list of 3"),
    ({"nu": [4.0, 0.42, 0.47]}, "nu", "nu12 = 4, with which some strain has no positive energy",
     r"\|nu12\| < sqrt\(E1 / E2\) = 3.53553"),
    ({"nu": [3.0, 3.0, 0.9]}, "nu", "no positive energy", "here it is -"),
    ({"axes": [[1, 0, 0]]}, "axes", "1 entries", "two vectors"),
    ({"axes": [[1, 0, 0], [0, 0, 0]]}, "axes", "entry 1 is", "not zero"),
    ({"axes": [[1, 2, 0], [-2, -4, 0]]}, "axes", "which are parallel", "span a plane"),
    ({"axes": [[1, 0, 0], [0, 1, 0]], "angle": 3}, "angle", "together with axes", "at most one"),
    ({"axis": [0, 0, 1]}, "axis", "without point", "point as well"),
    ({"yield_stress": 3.0}, "yield_stress", "of an orthotropic material", "elastic"),
    ({"law": "neo_hooke"}, "law", "neo_hooke", "E a number|finite"),
])  # fmt: skip
def test_refused(tmp_path, said, key, found, allowed):
    with pytest.raises(InputError, match=rf"materials\.m\.{key}: found .*{found}.*; allowed: .*({allowed})"):
        validate(scene(tmp_path, **said))


@pytest.mark.parametrize("mesh, key, found", [
    ({"strain": "finite"}, r"materials\.m\.E", "finite strain"),
    ({"mean_dilatation": True}, r"mesh\.mean_dilatation", "the orthotropic material m"),
])  # fmt: skip
def test_what_does_not_go_with_it(tmp_path, mesh, key, found):
    with pytest.raises(InputError, match=rf"{key}: found .*{found}.*; allowed: ."):
        validate(scene(tmp_path, mesh))
    case = scene(tmp_path, {"kinematics": "axisymmetric"}, point=[0, 0])
    with pytest.raises(InputError, match=r"materials\.m\.point: found .*axisymmetric"):
        validate(case)


@pytest.mark.parametrize("said, dim, key", [
    ({"axes": [[1, 0, 0.5], [0, 1, 0]]}, 2, "axes"), ({"point": [0, 0]}, 3, "point"), ({"point": [0, 0, 0]}, 3, "axis"),
    ({"point": [0, 0], "axis": [0, 1]}, 2, "axis"), ({"point": [0, 0, 0]}, 2, "point"),
])  # fmt: skip
def test_frame_fits_the_mesh(tmp_path, said, dim, key):
    case = scene(tmp_path, **said)
    validate(case)
    with pytest.raises(InputError, match=rf"materials\.m\.{key}: found .*; allowed: ."):
        check_dimension(case, dim)


@pytest.mark.parametrize("said, dim", [
    ({"axes": [[0, 0, 2], [1, 1, 0]]}, 2), ({"axes": [[1, 1, 0], [3, 0, 1]]}, 3), ({"angle": 30}, 2),
    ({"point": [0, 0]}, 2), ({"point": [0, 0, 0], "axis": [1, 0, 1]}, 3), ({"axes": [[1, 1, 0], [1, 1, 3]]}, 2),
])  # fmt: skip
def test_frames_that_are_taken(tmp_path, said, dim):
    case = scene(tmp_path, **said)
    validate(case)
    check_dimension(case, dim)


@pytest.mark.parametrize("seed", range(20))
def test_energy_is_positive_where_nothing_is_found(seed):
    """As the eigenvalues of the compliance say."""
    rng = np.random.default_rng(seed)
    young, poisson = rng.uniform(0.2, 5.0, 3).tolist(), rng.uniform(-1.2, 1.2, 3).tolist()
    compliance = np.diag(1.0 / np.array(young))
    for nu, (i, j) in zip(poisson, ((0, 1), (0, 2), (1, 2)), strict=True):
        compliance[i, j] = compliance[j, i] = -nu / young[i]
    assert (indefinite(young, poisson) is None) == bool(np.linalg.eigvalsh(compliance)[0] > 0.0)


def test_equivalent_poisson():
    assert equivalent_poisson(*isotropic(7.0, 0.3)) == pytest.approx(0.3)
    assert 0.0 < equivalent_poisson(*LAMINATE) < 0.5
