"""What the next pass runs with."""

from types import SimpleNamespace

import pytest

from pcontact.adapt.settings import Settings
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI, has_package
from pcontact.scene.model import Body, Material, MeshSpec, Scene
from pcontact.scene.target import Target


def _solver(plastic=True, dim=2, floating=None, chosen=(), petsc=None):
    """The preconditioner of the second pass, of a block whose first pass has run."""
    scene = Scene(mesh=MeshSpec("block.msh"), materials={"m": Material(1.0, 0.3, 0.1 if plastic else None)},
                  bodies=[Body("block", "m")], petsc=petsc or {})  # fmt: skip
    settings = Settings(scene, Target(0.1), Options("command line"))
    space = SimpleNamespace(comm=MPI.COMM_WORLD, dim=dim, n_dofs=1000)
    settings.follow(SimpleNamespace(problem=SimpleNamespace(space=space), newton=SimpleNamespace(kept_out=chosen),
                                    scene=scene, floating=floating or {}))  # fmt: skip
    return settings.scene().petsc.get("pc_type")


@pytest.mark.parallel(2)
def test_factors_where_bodies_yield_in_the_plane():
    """Not where the user has chosen, nor where contact alone holds a body: it has no factors before."""
    assert _solver() == ("lu" if has_package("mumps") or MPI.COMM_WORLD.size == 1 else None)
    assert _solver(plastic=False) is _solver(dim=3) is _solver(floating={0: 1}) is _solver(chosen=("pc_type",)) is None
    assert _solver(petsc={"pc_type": "gamg"}) == "gamg"


@pytest.mark.parametrize(
    "error, of, tolerance", [(0.05, "energy", "1e-08"), (1e-7, "energy", "1e-09"), (0.05, "support:left", "1e-10")]
)
def test_the_tolerance_is_small_enough_for_the_same_meshes_on_all_ranks(error, of, tolerance):
    settings = Settings(Scene(MeshSpec("block.msh"), {}, []), Target(error, of), Options("command line"))
    assert settings.scene().petsc["snes_rtol"] == tolerance
