"""What the next pass runs with."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcontact.adapt.mark import LEAP
from pcontact.adapt.settings import AIM, FACTORISED, THIRD, Settings
from pcontact.runtime.options import Options
from pcontact.scene.model import Body, Contact, Load, Material, MeshSpec, Scene, Steps
from pcontact.scene.target import Target


def _options(petsc=None, ranks=2, **contact):
    """Options of the first pass of two blocks, one of which may yield."""
    metal = Material(1.0, 0.3, contact.pop("yield_stress", None))
    scene = Scene(MeshSpec("blocks.msh"), {"metal": metal}, [Body("lower", "metal"), Body("upper", "metal")],
                  contacts=[Contact("upper_bottom", "lower_top", **contact)], petsc=petsc or {})  # fmt: skip
    return Settings(scene, Target(0.1), Options("command line"), ranks).scene().petsc


def test_linear_systems_are_solved_well_where_bodies_rub_or_yield():
    """By factors in the plane; where bodies rub, by multigrid, too. The user's own options stay. One rank also has
    factors where nothing rubs or yields."""
    tight, plane, loose = "snes_ksp_ew_rtolmax", "pc_direct_below", _options()
    assert tight not in loose and plane not in loose and _options(ranks=1)[plane] == str(FACTORISED)
    rubs, yields = _options(friction=0.3), _options(yield_stress=0.1)
    assert rubs[plane] == yields[plane] == "400000" and rubs[tight] == "1e-08" and tight not in yields
    assert _options({tight: "1e-3", plane: "7"}, friction=0.3)[plane] == "7"


@pytest.mark.parametrize(
    "error, of, tolerance", [(0.05, "energy", "1e-08"), (0.05, "support:left", "1e-10")]
)
def test_the_tolerance_is_small_enough_for_the_same_meshes_on_all_ranks(error, of, tolerance):
    settings = Settings(Scene(MeshSpec("block.msh"), {}, []), Target(error, of), Options("command line"))
    assert settings.scene().petsc["snes_rtol"] == tolerance


def _planned(amplitude=None, **parts):
    """Settings after a pass with ten load steps, where 0.1 is wanted in all."""
    loads = [Load("top", traction=[0.0, 1.0], amplitude=amplitude)]
    settings = Settings(Scene(MeshSpec("block.msh"), {}, [], loads=loads, steps=Steps(count=10)), Target(0.1),
                        Options("command line"))  # fmt: skip
    settings.balance(SimpleNamespace(parts={"mesh": 0.1, "algebraic": 0.0, **parts}), 0.1)
    return settings


def test_what_has_more_than_a_third_of_the_target_is_refined():
    """Load steps as many as leave its fair share, between corners of amplitudes as many as there is room for."""
    fair = AIM * THIRD * 0.1 / 2.0
    assert _planned(load_steps=0.03).steps == 10
    assert _planned(load_steps=0.036).steps == np.ceil(10 * 0.036 / fair)
    assert _planned(load_steps=1.0).steps == 10 * LEAP
    assert _planned(load_steps=0.005, quadrature=0.03).steps == 10
    corners = [(k / 4.0, float(k)) for k in range(5)]
    assert _planned(corners, load_steps=0.036).steps == 28
