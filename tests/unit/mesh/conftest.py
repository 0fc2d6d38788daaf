"""gmsh for the tests of meshes."""

import gmsh
import pytest


@pytest.fixture
def session():
    """A gmsh session that says nothing."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    yield
    gmsh.finalize()
