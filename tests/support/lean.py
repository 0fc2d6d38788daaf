"""Pieces of physics, each in modules of its own, and a scene that has none of them."""

from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene, Steps

# what asks for the law of a contact, and what contact without friction has, too
ASKED = ("contact_law", "Frictionless", "View", "_tresca", "_coulomb")
# modules of each piece; names in them that other physics uses, too, or that ask whether a scene has the piece
PIECES = {
    "friction": (("contact.formulation.frictional_kernels", "contact.formulation.frictional", "contact.law"), ASKED),
    "friction that varies": (
        ("contact.law",), (*ASKED, "FrictionLaw", "RowLaw", "Tied", "Held", "bound", "project", "_project_all",
                           "project_rows", "add_law"),
    ),
    "plasticity": (
        ("material.plastic", "material.hardening", "assembly.plastic", "assembly.plastic_kernels",
         "contact.traction.plastic"),
        (),
    ),
    "finite strain": (
        ("material.finite", "material.log_strain", "assembly.finite", "assembly.finite_kernels", "assembly.mixed",
         "assembly.deformation", "assembly.finite_energy"), (),
    ),
    "contact that moves": (
        ("contact.finite_pair", "contact.formulation.finite", "contact.formulation.finite_geometry",
         "contact.formulation.finite_kernels", "contact.traction.finite"),
        (),
    ),
    "pressure that follows": (("assembly.follower", "assembly.follower_kernels"), ()),
    "viscous stabilisation": (("assembly.viscous",), ()),
    "springs": (("assembly.springs",), ()),
    "pre-tension": (("space.section", "mesh.section"), ("plane",)),
    "phases": (("assembly.release",), ()),
    "equations": (("space.equations",), ()),
    "rigid groups": (("assembly.constrained", "space.rigid"), ()),
    "thermal strain": (("assembly.heat", "contact.traction.constant"), ()),
    "bodies that come and go": (
        ("mesh.present", "space.carried", "assembly.extension", "contact.traction.constant",
         "contact.traction.strain_free"), ("strain_free",),
    ),
    "fields of files": (("assembly.nodal_field",), ()),
    "self contact": (("contact.search.self_surface", "contact.search.exclusion", "contact.search.cones"),
        ("no_exclusion", "writable", "no_cones", "Exclusion", "Cones")),
    # bodies near enough to meet are found for any pair
    "all surfaces": (("contact.search.all_surfaces",), ("meetings", "near_pairs", "component_boxes")),
    "tied surfaces": (
        ("contact.law",), (*ASKED, "FrictionLaw", "RowLaw", "project", "bound", "project_rows", "_project_all"),
    ),
    "unbiased contact": (("contact.unbiased",), ("is_unbiased",)),
    "penalty": (("contact.formulation.methods",), ("Method",)),
    "augmented Lagrangian": (("contact.formulation.augmented",), ()),
    "soft layers": (("contact.formulation.layer",), ()),
    "initial gaps": (("contact.initial",), ("initial_gap",)),
    "obstacles": (("contact.surface.obstacle",), ()),
    "finite shapes": (("contact.surface.shapes",), ()),
    "rigid meshes": (("contact.surface.rigid_surface", "mesh.surface"), ()),
    # what says that a cell has none, and what axial symmetry needs, too
    "mean dilatation": (
        ("element.dilatation",), ("Mean", "Dilatation", "linear", "dilatation", "factors", "squares", "hoop_operator"),
    ),
}  # fmt: skip


def scene(path, **contact):
    """A block on another one, pressed sideways a little."""
    pair = Contact(**{"source": "upper_bottom", "target": "lower_top", "name": "pair"} | contact)
    return Scene(
        mesh=MeshSpec(path),
        materials={"soft": Material(1000.0, 0.3), "yields": Material(1000.0, 0.3, yield_stress=8.0, hardening=100.0)},
        bodies=[Body("lower", "soft"), Body("upper", "soft")],
        contacts=[pair],
        displacements=[
            Displacement("lower_bottom", [0.0, 0.0, 0.0]),
            Displacement("upper_top", [0.005, 0.0, -0.02]),
        ],
        steps=Steps(count=2),
        output=Output(fields=False),
    )
