"""Bodies bent so that they may meet themselves."""

import numpy as np

from pcontact.mesh.raw import complete
from pcontact.mesh.read import read_mesh
from pcontact.mesh.topology import components
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene, Steps
from pcontact.space.space import Space
from tests.support.dealt import distribute

SIDES = ("left", "right", "front", "back", "bottom", "top")


def skin_of(comm, path, change=None, degree=1, regions=("block",)):
    """Space on a mesh whose whole boundary is the group ``skin``, with other points. Collective."""
    arguments = (None,) * 4
    if comm.rank == 0:
        raw = read_mesh(path)
        raw.points = raw.points if change is None else np.ascontiguousarray(change(raw.points))
        raw = raw if degree == 1 else complete(raw, 2)
        body = np.zeros(sum(len(b.nodes) for b in raw.blocks), dtype=np.int64)
        for number, region in enumerate(regions):
            body[raw.cell_groups[region]] = number
        groups = [g for name, g in raw.facet_groups.items() if name.rpartition("_")[2] in SIDES]
        raw.facet_groups["skin"] = tuple(np.concatenate(parts) for parts in zip(*groups, strict=True))
        arguments = (raw, False, body, components(raw))
    mesh = distribute(comm, *arguments)
    mesh.component_names = [f"part {k}" for k in range(mesh.n_components)]
    return Space(mesh, degree)


def annulus(x, turn, inner=1.0, outer=1.4):
    """A unit box bent to a part of a ring: its first direction goes around, its last outwards, from `inner` on."""
    y = x.copy()
    angle, radius = -turn * x[:, 0], inner + (outer - inner) * x[:, -1]
    y[:, 0], y[:, -1] = radius * np.sin(angle), radius * np.cos(angle)
    y[:, 0] *= -1.0
    return y


def wedge(x, tip=0.01, slope=0.4):
    """A box that becomes thin towards the left."""
    y = x.copy()
    y[:, -1] = (x[:, -1] - 0.5) * (tip + slope * x[:, 0])
    return y


ALONE = {
    "plate": lambda x: x * [*[1.0] * (x.shape[1] - 1), 0.02],
    "block": lambda x: x,
    "wedge": wedge,
    "edge of a knife": lambda x: wedge(x, 1e-3, 1.5),
    "shell": lambda x: annulus(x, 5.0, 1.0, 1.05),
    "thick shell": lambda x: annulus(x, 5.0, 0.3, 1.0),
}


def strip(path, split, group="lips", **contact):
    """The ring is pressed from outside until its lips meet."""
    names = ("lip_upper", "lip_lower") if split else (group, group)
    regions = ("strip_upper", "strip_lower") if split else ("strip",)
    contact = {"friction": 0.3, "search_radius": 1.0, **contact}
    return Scene(
        mesh=MeshSpec(path),
        materials={"m": Material(1000.0, 0.3)},
        bodies=[Body(region, "m") for region in regions],
        contacts=[Contact(*names, name="lips", unbiased=split, **contact)],
        displacements=[Displacement("back", [0.0, 0.0])],
        loads=[Load("strip_outer", pressure=1.2)],
        steps=Steps(count=3),
        output=Output(fields=False, probes=["lip_upper", "lip_lower"]),
        petsc={"snes_rtol": "1e-9", "contact_partner_rtol": "1e-8", "ksp_type": "preonly", "pc_type": "lu",
               "pc_factor_mat_solver_type": "mumps"},
    )
