"""Any number of ranks makes the same meshes on the way to an error that is named."""

import json

import pytest

from drivers.studies._named_scenes import SCENES
from drivers.studies.same_meshes import TINY, passes, run
from pcontact.runtime.petsc import MPI
from pcontact.scene.target import Target


@pytest.mark.parallel
def test_ranks_make_the_meshes_of_one(shared_tmp):
    """Whatever their multigrid leaves of the solution."""
    scene, target = SCENES["rings"].scene(shared_tmp), Target(0.05, "pressure:circle")
    together, alone = (passes(scene, target, comm) for comm in (MPI.COMM_WORLD, MPI.COMM_SELF))
    assert together[0] == alone[0] and len(set(alone[0])) == len(alone[0]) > 1
    errors = [[one.error for one in found[1]] for found in (together, alone)]
    assert errors[0] == pytest.approx(errors[1], rel=1e-6)


def test_lines_of_passes(tmp_path):
    """One for each pass, without what only the last digits tell."""

    class Args:
        o, run, tiny = tmp_path, (), True

    assert run(Args) == 0
    lines = (tmp_path / "passes.txt").read_text().splitlines()
    assert len(lines) > 1 and all(line.startswith(f"{TINY[0]} pass {k} ") for k, line in enumerate(lines, 1))
    numbers = json.loads((tmp_path / "passes.json").read_text())
    errors = [float(line.split()[-1]) for line in lines]
    assert [one["error"] for one in numbers] == pytest.approx(errors, rel=0.01)
    assert [sum(one["parts"].values()) for one in numbers] == pytest.approx([one["error"] for one in numbers])
