"""Thermal stress of cells, none among them."""

import numpy as np
import pytest

from meshes import one_block
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Displacement, Material, MeshSpec, Output, Scene, Temperature
from pcontact.simulation import Simulation


@pytest.mark.parametrize("cells", [0, 3])
def test_stress_of_some_cells(tmp_path, cells):
    """As many rows as cells: an estimate asks for those at corners, of which a block may have none."""
    one_block(tmp_path / "square.msh", 2, 3)
    scene = Scene(
        MeshSpec(tmp_path / "square.msh"), {"m": Material(1000.0, 0.3, expansion=1e-3)}, [Body("block", "m")],
        displacements=[Displacement("bottom", [0.0, 0.0])], temperatures=[Temperature(20.0)],
        output=Output(fields=False),
    )  # fmt: skip
    simulation = Simulation(scene, MPI.COMM_SELF)
    try:
        assert simulation.run()
        rows, points = np.arange(cells), np.full((cells, 4, 2), 0.5)
        stress = simulation.problem.bulk.heat.on_cells(0, rows, rows, points)
    finally:
        simulation.close()
    assert stress.shape[:2] == (cells, 4) and stress.shape[2] in (3, 4)
    assert np.all(stress[..., 0] > 0.0), "E alpha dT / (1 - 2 nu)"
