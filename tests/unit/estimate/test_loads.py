"""Loads in the estimate: nothing where the exact displacement is in the space; what quadrature leaves out."""

from functools import partial
from math import erf, pi, sqrt

import numpy as np
import pytest

from drivers._common import make_mesh
from meshes import one_block
from pcontact.adapt.secondary import Last
from pcontact.assembly.loads import load_vector
from pcontact.estimate.loads import Given, missing
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.amplitude import Amplitude
from pcontact.scene.model import (
    Body,
    Coupling,
    Displacement,
    Load,
    Material,
    MeshSpec,
    Output,
    Scene,
    Spring,
    Temperature,
)
from pcontact.simulation import Simulation
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
    found = missing(space, [Given(load, STEADY)], 1.0)
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
    assert missing(space, [Given(Load("upper_top", traction=[0.0, -1.0]), STEADY)], 1.0).forces is None


TENSE = {"snes_rtol": "1e-12", "ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}


def loaded(kind, dim):
    """What a block has that is held at its bottom, or at corners, whose exact displacement has degree 2."""
    up, free = [0.0] * (dim - 1), ["free"] * (dim - 1)
    bottom = [Displacement("bottom", [0.0] * dim)]
    if kind == "weight":
        return {"displacements": bottom, "loads": [Load("block", acceleration=[*up, -0.5])]}
    if kind == "total":
        return {"displacements": bottom, "loads": [Load("top", force=[*up, -0.2])]}
    if kind == "springs":
        # the block itself stretches, and its springs as well: they bear what its bottom does not
        held = [Spring("bottom", per_area=[2.0] * dim), Spring("top", per_area=3.0)]
        return {"springs": held, "loads": [Load("top", traction=[*up, -0.2])]}
    if kind == "heat":
        corners = [Displacement(f"corner_{'0' * dim}", [0.0] * dim), Displacement(f"corner_1{'0' * (dim - 1)}",
                                                                                  ["free", *up])]  # fmt: skip
        corners += [Displacement("corner_010", ["free", "free", 0.0])] if dim == 3 else []
        return {"displacements": corners, "temperatures": [Temperature("2 + 3*y", reference=1.0)]}
    moved = Coupling("top", displacement=[*(free if kind == "average" else up), -0.1], rotation=[0.0] * 3 if dim == 3
                     else 0.0, average=kind == "average")  # fmt: skip
    return {"displacements": bottom, "couplings": [moved]}


KINDS = ("weight", "total", "springs", "heat", "rigid", "average")


@pytest.mark.parallel
@pytest.mark.parametrize("cell, kind", [
    *((cell, kind) for cell in ("triangle", "tetrahedron") for kind in KINDS), ("quadrilateral", "heat"),
])  # fmt: skip
def test_zero_where_the_displacement_is_in_the_space(shared_tmp, cell, kind):
    dim = 3 if cell == "tetrahedron" else 2
    path = make_mesh(one_block, shared_tmp / f"block{dim}.msh", dim, 2, cell)
    scene = Scene(
        MeshSpec(path, order=2, mean_dilatation=True if cell == "quadrilateral" else None),
        {"m": Material(10.0, 0.0, density=2.0, expansion=1e-2)}, [Body("block", "m")],
        output=Output(fields=False, estimate=True), petsc=TENSE, **loaded(kind, dim),
    )  # fmt: skip
    simulation, last = Simulation(scene), Last()
    try:
        assert simulation.run(None, [last])
    finally:
        simulation.close()
    found = last.record["estimate"]
    assert found["absolute"] < 1e-8 * found["energy_norm"]
