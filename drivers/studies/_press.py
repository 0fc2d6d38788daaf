"""The ball pressed into a block on which the cost of contact is measured, case by case.

The cases: linear (elastic bodies under body forces, no contact), elastic (frictionless contact), frictional (Coulomb),
the same two with finite strain (finite, finite_frictional),
plastic (frictionless contact; perfect plasticity of both bodies), stick (a bound of friction that nothing reaches: all
closed points stick), and stick with the source or the target 100 times stiffer than the other, or with 100 times the
default gamma0.
"""

from pathlib import Path

from drivers.studies._harness import composed
from pcontact.scene.model import Contact, Load, Material, MeshSpec, Scene

# per case: stiffness of the ball and of the block [stress], gamma0 (None: the default)
STICK = {
    "stick": (1.0e3, 1.0e3, None),
    "stick_source": (1.0e5, 1.0e3, None),
    "stick_target": (1.0e3, 1.0e5, None),
    "stick_gamma": (1.0e3, 1.0e3, 100.0),
}
FINITE = {"finite": "elastic", "finite_frictional": "frictional"}  # with finite strain
CASES = ("linear", "elastic", "frictional", "plastic", *FINITE, *STICK)
BOUND = 1e6  # of friction, a thousand times the modulus [stress]
DEPTH = 0.02  # that the ball is pressed down [length]
# cell and degree of the displacement
CELLS = {
    "tetrahedra": ("tetrahedron", 1),
    "tetrahedra2": ("tetrahedron", 2),
    "hexahedra": ("hexahedron", 1),
    "hexahedra2": ("hexahedron", 2),
}


def make_scene(
    mesh: Path,
    case: str,
    theta: float = 0.0,
    friction: float = 0.3,
    yield_stress: float = 5.0,
    cells: str = "tetrahedra",
) -> Scene:
    """The scene of a case.

    Parameters
    ----------
    mesh : Path
        Of `meshes.ball_on_block` or `meshes.dome_on_block`.
    case : str
        One of `CASES`.
    theta : float
        Variant of Nitsche's method.
    friction, yield_stress : float
        Of the cases frictional and plastic.
    cells : str
        One of `CELLS`: its degree is that of the displacement.
    """
    strain, case = ("finite" if case in FINITE else "small"), FINITE.get(case, case)
    ball, block, gamma0 = STICK.get(case, STICK["stick"])
    bound = yield_stress if case == "plastic" else None
    moduli = {"ball": ball, "block": block}
    result = composed(
        MeshSpec(mesh, CELLS[cells][1], strain=strain),
        {name: Material(modulus, 0.3, yield_stress=bound) for name, modulus in moduli.items()},
        {"block_bottom": [0.0, 0.0, 0.0], "ball_top": [0.0, 0.0, 0.0 if case == "linear" else -DEPTH]},
        title=f"ball on block, {case}",
    )
    if case != "linear":
        law = {"friction": friction} if case == "frictional" else {"tresca": BOUND} if case in STICK else {}
        contact = Contact("ball_skin", "block_top", name="ball-block", theta=theta, gamma0=gamma0, **law)
        result.contacts = [contact]
        return result
    result.loads = [Load(region, body_force=[0.3, -0.2, 1.0]) for region in moduli]
    result.petsc = {"ksp_rtol": "1e-8", "snes_type": "ksponly"}
    if theta != 1.0:
        # the Krylov method of the others
        result.petsc.update(ksp_type="gmres", ksp_pc_side="right")
    return result
