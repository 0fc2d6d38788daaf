"""What the next pass runs with."""

from types import SimpleNamespace

import pytest

from pcontact.adapt.settings import AIM, STEPS_RATE, STEPS_SHARE, Settings
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
    factors where nothing rubs or yields, up to fewer unknowns."""
    tight, plane, loose = "snes_ksp_ew_rtolmax", "pc_direct_plane", _options()
    assert tight not in loose and plane not in loose and _options(ranks=1)[plane] == "30000"
    rubs, yields = _options(friction=0.3), _options(yield_stress=0.1)
    assert rubs[plane] == yields[plane] == "400000" and rubs[tight] == "1e-08" and tight not in yields
    assert _options({tight: "1e-3", plane: "7"}, friction=0.3)[plane] == "7"


@pytest.mark.parametrize(
    "error, of, tolerance", [(0.05, "energy", "1e-08"), (1e-7, "energy", "1e-09"), (0.05, "support:left", "1e-10")]
)
def test_the_tolerance_is_small_enough_for_the_same_meshes_on_all_ranks(error, of, tolerance):
    settings = Settings(Scene(MeshSpec("block.msh"), {}, []), Target(error, of), Options("command line"))
    assert settings.scene().petsc["snes_rtol"] == tolerance


def _planned(grow, growth, amplitude=None, most=4):
    """Settings after a pass with ten load steps, which leave 0.05 where 0.1 is wanted in all."""
    loads = [Load("top", traction=[0.0, 1.0], amplitude=amplitude)]
    settings = Settings(Scene(MeshSpec("block.msh"), {}, [], loads=loads, steps=Steps(count=10)), Target(0.1),
                        Options("command line"))  # fmt: skip
    done = SimpleNamespace(parts={"mesh": 0.1, "load_steps": 0.05, "algebraic": 0.0}, steps_grow=grow)
    settings.balance(done, 0.1, growth, most)
    return settings


def test_load_steps_are_planned_for_the_mesh_to_come():
    """Their error grows with the unknowns; between corners of amplitudes there are as many as there is room for."""
    wanted = AIM * STEPS_SHARE * 0.1
    usual, grown = (10.0 * (part / wanted) ** (1.0 / STEPS_RATE) for part in (0.05, 0.05 * 4.0**0.5))
    assert _planned(0.0, 4.0).steps == -(-usual // 1) and _planned(0.5, 4.0).steps == -(-grown // 1)
    assert _planned(0.5, 4.0, most=2).steps == 20
    corners = [(k / 4.0, float(k)) for k in range(5)]
    settings = _planned(0.0, 4.0, corners)
    assert settings.steps == 16 + 4 * (usual > 16)
    assert settings.halved(20) == 8 and settings.halved(4) == 2
