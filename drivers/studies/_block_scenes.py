"""Blocks whose displacement is singular at corners: one on the other, or one under a load of each kind."""

import gmsh

from drivers._common import make_mesh
from drivers.studies._harness import composed
from meshes import one_block, two_blocks
from meshes.tools import finish, gmsh_model, group, unstructured
from pcontact.scene.model import (
    Contact,
    Coupling,
    Displacement,
    Load,
    Material,
    MeshSpec,
    Spring,
    Temperature,
)

DIRECT = {"pc_type": "lu", "ksp_type": "preonly", "pc_factor_mat_solver_type": "mumps"}
BLOCKS = {
    "friction": {"friction": 0.3},
    "tresca": {"tresca": 0.02},
    "unbiased": {"unbiased": True},
    "tied": {"tied": True},
    "stiff": {},
    "laminate": {"friction": 0.3},
    "lower": {"friction": 0.3},
    "joined": {},
    "die": {},
}
# what the block has beside its held left side, in the plane; see `loaded`
LOADS = ("weight", "spin", "total", "heat", "heat_fibres", "springs", "rigid", "average")
# carbon fibres, and spruce: E, nu, G along axes 1, 2, 3 [GPa]; around an axis along radius, hoop and axis
FIBRES = ([140.0, 10.0, 10.0], [0.3, 0.3, 0.45], [5.0, 5.0, 3.448])


def joined(path, dim, n):
    """Two blocks like those of `meshes.two_blocks` that share their nodes where they meet."""
    with gmsh_model("joined"):
        occ = gmsh.model.occ
        if dim == 2:
            parts = [(2, occ.addRectangle(0.0, y, 0.0, 1.0, 1.0)) for y in (0.0, 1.0)]
        else:
            parts = [(3, occ.addBox(0.0, 0.0, z, 1.0, 1.0, 1.0)) for z in (0.0, 1.0)]
        occ.fragment(parts[:1], parts[1:])
        occ.synchronize()
        for name, end in (("lower", 0.0), ("upper", 2.0)):
            middle = 0.5 * (1.0 + end)
            near = [tag for _, tag in gmsh.model.getEntities(dim)
                    if abs(occ.getCenterOfMass(dim, tag)[dim - 1] - middle) < 0.1]  # fmt: skip
            group(dim, name, near)
            group(dim - 1, f"{name}_{'bottom' if end == 0.0 else 'top'}",
                  [tag for _, tag in gmsh.model.getEntities(dim - 1)
                   if abs(occ.getCenterOfMass(dim - 1, tag)[dim - 1] - end) < 0.1])  # fmt: skip
        gmsh.option.setNumber("Mesh.MeshSizeMax", 1.0 / n)
        unstructured("triangle" if dim == 2 else "tetrahedron")
        return finish(path, dim, 1)


def loaded(place, kind, n, degree, folder):
    """A block of triangles or tetrahedra under one kind of load."""
    dim = 2 if place == "plane" else 3
    path = make_mesh(one_block, folder / f"block_{dim}_{n}.msh", dim, n, "triangle" if dim == 2 else "tetrahedron")
    rest, ones = [0.0] * (dim - 2), ["free"] * (dim - 1)
    material = Material(10.0, 0.3, density=2.0, expansion=1e-2)
    if kind == "heat_fibres":
        material = Material(*FIBRES[:2], G=FIBRES[2], angle=30.0, expansion=[1e-3, 1e-2, 1e-2])
    held, more = [Displacement("left", [0.0] * dim)], {}
    if kind == "weight":
        more["loads"] = [Load("block", acceleration=[0.0, -0.1, *rest])]
    elif kind == "spin":
        axis = {} if dim == 2 else {"axis": [0.0, 0.0, 1.0]}
        more["loads"] = [Load("block", angular_speed=0.3, point=[0.0, -0.5, *rest], **axis)]
    elif kind == "total":
        moment = 0.1 if dim == 2 else (0.0, 0.0, 0.1)
        more["loads"] = [Load("right", force=[0.1, -0.1, *rest], moment=moment)]
    elif kind.startswith("heat"):
        more["temperatures"] = [Temperature("exp(-8*((x-0.6)**2+(y-0.7)**2))")]
    elif kind == "springs":
        more["springs"] = [Spring("bottom", per_area=100.0), Spring("right", stiffness=[1.0, 3.0, 2.0][:dim]),
                           Spring("block", stiffness=[5.0, 1.0, 2.0][:dim])]  # fmt: skip
        more["loads"], held = [Load("top", traction=[0.3, *rest, -0.5])], []
    else:
        turn = 0.02 if dim == 2 else (0.0, 0.02, 0.02)
        more["couplings"] = [Coupling("right", point=[1.0, 0.5, 0.5][:dim], rotation=turn, average=kind == "average",
                                      displacement=[0.01, *ones[:-1], "free"])]  # fmt: skip
        more["loads"] = [Load("block", body_force=[0.1, -0.1, *rest])]
    return composed(
        MeshSpec(path, order=degree), {"block": material}, held, DIRECT, title=f"block, {kind}, degree {degree}", **more
    )


def laminates():
    """The materials of two blocks of laminates, by their regions."""
    moduli, ratios, shear = FIBRES
    return {name: Material(moduli, ratios, G=shear, angle=angle) for name, angle in (("lower", 30.0), ("upper", -50.0))}


def blocks(place, kind, n, degree, theta, folder, finer=False):
    """Two blocks of triangles or tetrahedra whose meshes do not match."""
    dim = 2 if place == "plane" else 3
    cell = "triangle" if dim == 2 else "tetrahedron"
    path = make_mesh(two_blocks, folder / f"blocks_{dim}_{n}.msh", dim, n, n + (n + 1) // 2, cell)
    shared = kind in ("joined", "die")
    if shared:
        path = make_mesh(joined, folder / f"joined_{dim}_{n}.msh", dim, n)
    own = 1 if (shared or kind == "lower") and not finer else None
    contact = Contact("upper_bottom", "lower_top", name="face", theta=theta, **BLOCKS[kind])
    soft = Material(10.0, 0.3)
    plain = {"lower": Material(10000.0, 0.3) if kind in ("stiff", "die") else soft, "upper": soft}
    scene = composed(
        MeshSpec(path, order=degree),
        laminates() if kind == "laminate" else plain,
        {"lower_bottom": [0.0] * dim, "upper_top": [0.02] + [0.0] * (dim - 2) + [-0.05]},
        DIRECT,
        title=f"blocks, {kind}, degree {degree}",
        contacts=[] if shared else [contact],
    )
    scene.bodies[0].order = own
    return scene
