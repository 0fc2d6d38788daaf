"""What the next pass runs with."""

import pytest

from pcontact.adapt.settings import Settings
from pcontact.runtime.options import Options
from pcontact.scene.model import Body, Contact, Material, MeshSpec, Scene
from pcontact.scene.target import Target


def _options(petsc=None, **contact):
    """Options of the first pass of two blocks, one of which may yield."""
    metal = Material(1.0, 0.3, contact.pop("yield_stress", None))
    scene = Scene(MeshSpec("blocks.msh"), {"metal": metal}, [Body("lower", "metal"), Body("upper", "metal")],
                  contacts=[Contact("upper_bottom", "lower_top", **contact)], petsc=petsc or {})  # fmt: skip
    return Settings(scene, Target(0.1), Options("command line")).scene().petsc


def test_linear_systems_are_solved_well_where_bodies_rub_or_yield():
    """By factors in the plane; where bodies rub, by multigrid, too. The user's own options stay."""
    tight, plane, loose = "snes_ksp_ew_rtolmax", "pc_direct_plane", _options()
    assert tight not in loose and plane not in loose
    rubs, yields = _options(friction=0.3), _options(yield_stress=0.1)
    assert rubs[plane] == yields[plane] == "400000" and rubs[tight] == "1e-08" and tight not in yields
    assert _options({tight: "1e-3", plane: "7"}, friction=0.3)[plane] == "7"


@pytest.mark.parametrize(
    "error, of, tolerance", [(0.05, "energy", "1e-08"), (1e-7, "energy", "1e-09"), (0.05, "support:left", "1e-10")]
)
def test_the_tolerance_is_small_enough_for_the_same_meshes_on_all_ranks(error, of, tolerance):
    settings = Settings(Scene(MeshSpec("block.msh"), {}, []), Target(error, of), Options("command line"))
    assert settings.scene().petsc["snes_rtol"] == tolerance
