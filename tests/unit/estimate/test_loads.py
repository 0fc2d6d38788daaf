"""What the quadrature of loads leaves out."""

from functools import partial
from math import erf, pi, sqrt

import numpy as np
import pytest

from pcontact.assembly.loads import load_vector
from pcontact.estimate.loads import missing
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.amplitude import Amplitude
from pcontact.scene.model import Load
from tests.support.small import blocks_file, make_space

COMM = MPI.COMM_WORLD
STEADY = Amplitude(np.array([0.0, 1.0]), np.ones(2))


@pytest.mark.parallel
@pytest.mark.parametrize("key", ["traction", "body_force"])
def test_a_bump_that_is_as_wide_as_a_facet(shared_tmp, key):
    """What is integrated and what is missing make the integral; what is missing is where the bump is."""
    path = shared_tmp / "blocks.msh"
    on_root(COMM, partial(blocks_file, path, "triangle", 4, 5))
    space, region = make_space(COMM, path, ["lower", "upper"], 2), "upper_top" if key == "traction" else "upper"
    load = Load(region, **{key: [0.0, "exp(-100*(x-0.5)**2)"]})
    found = missing(space, [(load, STEADY)], 1.0)
    own = [load_vector(space, load, time=1.0)[:, 1].sum(), found.forces[:, 1].sum()]
    sums = COMM.allreduce(np.array(own), op=MPI.SUM)
    exact = sqrt(pi) / 10.0 * erf(5.0)
    assert abs(sums.sum() / exact - 1.0) < 1e-5 < 1e-4 < abs(sums[0] / exact - 1.0)
    far = [np.abs(space.mesh.points[block.nodes].mean(axis=1)[:, 0] - 0.5) > 0.3 for block in space.mesh.blocks]
    own = [sum(cells.sum() for cells in found.cells),
           sum(cells[rows].sum() for cells, rows in zip(found.cells, far, strict=True))]  # fmt: skip
    every, others = COMM.allreduce(np.array(own), op=MPI.SUM)
    assert others < 1e-2 * every


def test_loads_that_are_the_same_everywhere(tmp_path):
    space = make_space(MPI.COMM_SELF, blocks_file(tmp_path / "blocks.msh", "triangle"), ["lower", "upper"])
    assert missing(space, [(Load("upper_top", traction=[0.0, -1.0]), STEADY)], 1.0).forces is None
