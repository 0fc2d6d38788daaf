"""What a scene may say of inertia."""

import pytest

from pcontact.runtime.errors import InputError
from pcontact.scene.describe import describe
from pcontact.scene.integrators import INTEGRATORS
from pcontact.scene.phases import scene_of
from pcontact.scene.reader import scene_from
from pcontact.scene.validate import resolve_contacts, validate


def scene(folder, **more):
    (folder / "mesh.msh").write_text("")
    data = {
        "mesh": {"file": "mesh.msh"}, "materials": {"m": {"E": 1.0, "nu": 0.3, "density": 2.0}},
        "bodies": [{"region": "one", "material": "m", "initial_velocity": [0, "x"]}],
        "contacts": [{"source": "a", "target": "b"}], "dynamics": {},
    }  # fmt: skip
    return scene_from({**data, **more}, folder)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"materials": {"m": {"E": 1.0, "nu": 0.3}}},
         r"materials\.m\.density: found nothing, with \[dynamics\] \(body one\); allowed: a number > 0"),
        ({"dynamics": {"integrator": "trapezoidal", "alpha": -0.1}},
         r'dynamics\.alpha: found -0\.1 without integrator = "hht" or integrator = "bossak"; allowed: '),
        ({"dynamics": {"step_error": 1e-3}},
         r'dynamics\.step_error: found 0\.001 without \[steps\] control = "auto"; allowed: '),
        ({"dynamics": {"alpha": -0.5}}, r"dynamics\.alpha: found .*-0\.5; allowed: a number from -1/3 to 0"),
        ({"dynamics": {"integrator": "midpoint"}}, r'dynamics\.integrator: found a string .midpoint.; allowed: "hht"'),
        ({"accuracy": {"error": 0.02}}, r"accuracy\.error: found 0\.02 together with \[dynamics\]"),
        ({"output": {"estimate": True}}, r"output\.estimate: found true together with \[dynamics\]"),
        ({"bodies": [{"region": "one", "material": "m", "strain": "finite", "stiffness_damping": 1.0}]},
         r"bodies\[0\] \(one\)\.stiffness_damping: found 1 of a body with finite strain; allowed: 0"),
        ({"couplings": [{"region": "a", "average": True, "mass": 1.0}]},
         r"couplings\[0\] \(a\)\.mass: found 1.0 together with average = true; allowed: nothing: a group on average"),
        ({"dynamics": {"phases": ["later"]}}, r"dynamics\.phases: found .*without \[\[phases\]\]"),
        ({"dynamics": {"phases": ["later"]}, "phases": [{"name": "first"}, {"name": "late"}]},
         r"dynamics\.phases: found .*no such phase"),
        ({"dynamics": {"phases": ["two"]}, "phases": [{"name": "first"}, {"name": "two"}],
          "bodies": [{"region": "one", "material": "m", "initial_displacement": [0, 1]}]},
         r"initial_displacement: found a displacement, and the phase 'first' without inertia before"),
    ],
)  # fmt: skip
def test_it_says_what_is_wrong(tmp_path, more, message):
    with pytest.raises(InputError, match=message):
        scene(tmp_path, **more)


def test_what_has_no_mesh_has_mass_in_phases_with_inertia(tmp_path):
    group = {"region": "a", "mass": 1.0, "inertia": 2.0}
    phases = [{"name": "first"}, {"name": "two"}]
    whole = scene(tmp_path, couplings=[group], phases=phases, dynamics={"phases": ["two"]})
    parts = [scene_of(whole, number).couplings[0] for number in range(2)]
    assert [(one.mass, one.inertia) for one in parts] == [(0.0, 0.0), (1.0, 2.0)]


@pytest.mark.parametrize("key", ["initial_velocity", "mass_damping"])
def test_bodies_do_not_move_without_inertia(tmp_path, key):
    whole = scene(tmp_path)
    whole.dynamics = None
    whole.bodies[0].initial_velocity = None
    setattr(whole.bodies[0], key, [0.0, 1.0] if "velocity" in key else 1.0)
    with pytest.raises(InputError, match=rf"{key}: found .* without \[dynamics\]; allowed: \[dynamics\] as well"):
        validate(whole)


def test_theta_is_one_where_it_is_not_said(tmp_path):
    assert resolve_contacts(scene(tmp_path), {}).contacts[0].theta == 1.0
    assert resolve_contacts(scene(tmp_path), {"theta": 0.0}).contacts[0].theta == 0.0
    said = scene(tmp_path, contacts=[{"source": "a", "target": "b", "theta": -1}])
    assert resolve_contacts(said, {}).contacts[0].theta == -1.0
    penalty = scene(tmp_path, contacts=[{"source": "a", "target": "b", "formulation": "penalty"}])
    assert resolve_contacts(penalty, {}).contacts[0].theta == 0.0
    soft = scene(tmp_path, materials={"m": {"E": 1.0, "nu": 0.3, "density": 2.0, "yield_stress": 1.0}})
    assert resolve_contacts(soft, {}).contacts[0].theta == 0.0
    still = scene(tmp_path)
    still.dynamics = None
    assert resolve_contacts(still, {}).contacts[0].theta == 0.0


def test_a_velocity_is_given_once(tmp_path):
    """Where the first phase with inertia begins."""
    phases = [{"name": name} for name in ("press", "hit", "fly", "rest")]
    whole = scene(tmp_path, phases=phases, dynamics={"phases": ["hit", "fly"]})
    parts = [scene_of(whole, number) for number in range(4)]
    assert [part.dynamics is not None for part in parts] == [False, True, True, False]
    assert [part.bodies[0].initial_velocity is not None for part in parts] == [False, True, False, False]
    active, left_out = describe(whole)
    assert "inertia: integrator hht, alpha -0.1, consistent mass, in hit, fly" in active and "inertia" not in left_out


@pytest.mark.parametrize("name", INTEGRATORS)
def test_integrators_are_exact_for_a_steady_acceleration(name):
    """d0 + d1 = 1/2 and s0 + s1 = 1, but for the Euler rule, which is of first order."""
    row = INTEGRATORS[name]
    for alpha in (row.alpha,) if row.alpha is None else (row.alpha, -0.3, 0.0):
        weights = row.weights(alpha)
        assert sum(weights.velocity) == pytest.approx(1.0, rel=1e-15)
        assert sum(weights.displacement) == pytest.approx(1.0 if name == "euler" else 0.5, rel=1e-15)
