"""Two blocks in full contact, either surface the source."""

from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene, Temperature
from tests.support.pairs import by_key


def scene(path, dim, ratio, swapped=False, own=(), strain="small", load=1e-3, nu=(0.3, 0.3), **contact):
    """Two blocks, the upper one ``ratio`` times as stiff; its top bears a pressure that varies about a load.
    Bodies have what their materials say besides, ``own``, and what expands is heated."""
    sides = ("lower_top", "upper_bottom") if swapped else ("upper_bottom", "lower_top")
    unit, free = min(1.0, ratio), ["free"] * (dim - 1)
    traction = [0.0] * (dim - 1) + [f"{-load * unit}*(1 + 0.5*cos(pi*x))"]
    supports = [Displacement("lower_bottom", [0.0] * dim), Displacement("left", [0.0, *free]),
                Displacement("right", [0.0, *free])]  # fmt: skip
    if dim == 3:
        supports += [Displacement(side, ["free", 0.0, "free"]) for side in ("front", "back")]
    own = own or ({}, {})
    hot = [Temperature(value="0.01*x", region=name) for name, said in zip(("lower", "upper"), own, strict=True) if
           "expansion" in said]  # fmt: skip
    return Scene(
        title="exchanged",
        mesh=MeshSpec(path, strain=strain),
        materials={"soft": Material(1.0, nu[0], **own[0]), "other": Material(ratio, nu[1], **own[1])},
        bodies=[Body("lower", "soft"), Body("upper", "other")],
        contacts=[Contact(*sides, name="c", cut=True, **contact)],
        displacements=supports,
        loads=[Load("upper_top", traction=traction)],
        temperatures=hot,
        output=Output(fields=False),
        petsc={"snes_rtol": "1e-11", "ksp_rtol": "1e-12"},
    )


def displacement(simulation):
    """Of all nodes in the order of the file, iterations of the largest load step. *Collective.*"""
    space = simulation.problem.space
    owned = space.local.gather(simulation.stepper.u)[space.owned_local]
    return by_key(space, owned), len(simulation.newton.norms) - 1
