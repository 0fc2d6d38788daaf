"""Scenes drawn from seeds, and the references of the study that runs them."""

from pathlib import Path

import numpy as np
import pytest

from drivers.studies import random_errors
from drivers.studies._random_scenes import drawn
from drivers.studies.random_errors import deep, made
from pcontact.scene.validate import validate


@pytest.mark.parametrize("seed", range(12))
def test_scenes_are_valid_and_the_same_each_time(tmp_path, seed):
    """A seed gives the same scene and mesh each time, and meshes of references are those of its geometry."""
    one, other = drawn(seed), drawn(seed)
    assert one.kind == other.kind and one.quantities == other.quantities
    scene = one.begun(tmp_path)
    validate(scene)
    first = Path(scene.mesh.file).read_bytes()
    other.begun(tmp_path)
    assert Path(scene.mesh.file).read_bytes() == first
    validate(one.graded(tmp_path, 0.8))


def test_seeds_differ():
    """Families, kinematics, cells and sizes are all drawn, and so are quantities."""
    words = {word for seed in range(200, 300) for word in drawn(seed).kind.split(", ")}
    assert {"beam", "wedge", "notch", "roller", "rings", "layer", "stack", "in space", "axisymmetric", "plane stress",
            "tied", "friction", "plastic", "orthotropic", "one cell", "badly graded", "tetrahedra", "mixed",
            "geometry"} <= words  # fmt: skip


def test_a_reference_is_as_good_as_it_says(tmp_path, monkeypatch):
    """A cheap reference differs from one on finer meshes by no more than it says; in space it is the same solution."""
    scene = next(one for one in map(drawn, range(200, 300)) if one.kind.startswith("rings") and not one.rests)
    monkeypatch.setattr(random_errors, "GROWTHS", (0.8, 0.6, 0.45))
    rough = made(scene, 1.0, tmp_path)
    fine = made(scene, 1e-9, tmp_path)
    assert rough.unknowns < fine.unknowns and fine.error < rough.error
    for of, (value, error) in rough.values.items():
        assert value == pytest.approx(fine.values[of][0], rel=2.0 * error)
    solid = deep(fine, 0.5)
    assert solid.norm == pytest.approx(np.sqrt(0.5) * fine.norm)
    area, volume = (sum(one.weight.sum() for one in some.clouds) for some in (fine, solid))
    assert volume == pytest.approx(0.5 * area)
