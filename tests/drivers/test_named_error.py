"""What stands for the exact solution in the study of named errors."""

from functools import partial

import pytest

from drivers.cases import rings
from drivers.studies._harness import solved
from drivers.studies._named_reference import Reference, made
from drivers.studies._named_scenes import SCENES
from drivers.studies.named_error import Answer


def test_a_reference_is_as_good_as_it_says(tmp_path):
    """The distance to it is the error against the exact solution, but for what it lacks; and so is a force of it."""
    named = SCENES["rings"]
    scene = named.scene(tmp_path)
    made(scene, 0.03, ["force:circle"]).write(tmp_path / "kept.npz")
    best = Reference.read(tmp_path / "kept.npz")
    assert best.error < 0.03
    answer = Answer(partial(rings.exact, constants=rings.ring_constants()))
    with solved(scene) as (run, _):
        answer(run, True)
    distance = best.distance(answer.solution.at, answer.axisymmetric, answer.laws)
    assert distance == pytest.approx(answer.error, abs=best.error**2 / answer.error + 1e-4)
    force, error = best.values["force:circle"]
    # the facets are not quite the circle
    assert force == pytest.approx(named.known["force:circle"], rel=error + 3e-3)
