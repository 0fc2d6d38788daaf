"""Pieces of physics and features, what is theirs alone, keys of each, and a scene that has none of them."""

from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene, Steps

# what asks for the law of a contact, and what contact without friction has, too
ASKED = ("contact_law", "sticks_by_shear", "Frictionless", "View", "_tresca", "_coulomb")
# of each piece modules, or "module:name" for one class or function of a module, or a method of a class of it; names in
# its modules that other physics uses, too, or that ask whether a scene has the piece
PIECES = {
    "friction": (("contact.law",), ASKED),
    "friction that varies": (
        ("contact.law",), (*ASKED, "FrictionLaw", "RowLaw", "Tied", "Held", "bound_of", "project", "project_all",
                           "add_law"),
    ),
    "plasticity": (
        ("material.plastic", "material.hardening", "assembly.solid:PointStates", "assembly.strains:add_forces",
         "contact.traction.small:_Excess"),
        (),
    ),
    "finite strain": (
        ("material.finite", "material.log_strain", "assembly.finite", "assembly.finite_kernels",
         *(f"assembly.measures:{name}" for name in ("principal_stretches", "rotation_vectors", "mean_gradients",
                                                     "deformation_fields", "Deformation", "deformations"))), (),
    ),
    "contact that moves": (
        ("contact.finite_pair", "contact.formulation.finite", "contact.formulation.finite_geometry",
         "contact.formulation.finite_kernels", "contact.traction.finite"),
        (),
    ),
    "pressure that follows": (("assembly.follower",), ()),
    "viscous stabilisation": (("assembly.viscous",), ()),
    "springs": (("assembly.springs",), ()),
    "inertia": (("assembly.inertia", "assembly.mass"), ()),
    "pre-tension": (("space.constraints:PretensionSection", "mesh.topology:cut"), ("plane",)),
    "phases": (tuple(f"assembly.phases:{name}" for name in ("equilibrium", "borne_by", "Release")), ()),
    "equations": (("space.constraints:Equations", "space.constraints:eliminate"), ()),
    "rigid groups": (("assembly.matrix:ConstrainedMatrix", "space.constraints:RigidGroup"), ()),
    "thermal strain": (("assembly.heat",), ()),
    "bodies that come and go": (
        ("mesh.topology:without", "mesh.topology:missing", "space.space:carried", "assembly.phases:extend",
         "contact.traction.small:_Begun"),
        (),
    ),
    "fields of files": (("assembly.nodal_field",), ()),
    "self contact": (
        ("contact.search.self_contact:SelfSurface", "contact.search.self_contact:self_surface",
         "contact.search.exclusion",
         *(f"contact.search.tree:{name}" for name in ("normal_cones", "angle_between", "holds_none", "is_behind"))),
        ("no_exclusion", "writable", "Exclusion"),
    ),
    # bodies near enough to meet are found for any pair
    "all surfaces": (tuple(f"contact.search.self_contact:{name}"
                           for name in ("outer_surfaces", "facet_ids", "paired_elsewhere", "burdened")), ()),
    "tied surfaces": (
        ("contact.law",), (*ASKED, "FrictionLaw", "RowLaw", "project", "bound_of", "project_all"),
    ),
    "unbiased contact": (("contact.formulation.methods:halved", "contact.formulation.methods:contacts_of_halves"), ()),
    "penalty": (("contact.formulation.methods:Penalty", "contact.formulation.methods:facet_columns",
                 "contact.formulation.methods:without_traction"), ()),
    "augmented Lagrangian": (tuple(f"contact.formulation.methods:{name}" for name in (
        "AugmentedLagrangian", "acting", "update_multipliers")), ()),
    "soft layers": (("contact.formulation.layer",), ()),
    "initial gaps": (("contact.search.partners:InitialGap",), ()),
    "obstacles": (("contact.surface.obstacle",), ()),
    "finite shapes": (
        tuple(f"contact.surface.obstacle:{name}"
              for name in ("punch", "wedge", "turned_around", "drawn_along", "_torus")), (),
    ),
    "rigid meshes": (("contact.surface.obstacle:RigidSurface", "mesh.read:read_surface"), ()),
    # what says that a cell has none, and what axial symmetry needs, too
    "mean dilatation": (
        ("element.dilatation",), ("Mean", "Dilatation", "linear", "dilatation", "factors", "squares", "hoop_operator"),
    ),
}  # fmt: skip
# any run has it, or it is a number, a name or a choice of what the run has anyway
ANY = "any run"
# modules, or functions of them, below the package, that only a run with the feature calls
FEATURES = {
    "serendipity": ["mesh.raw:without_middles"],
    "reduced integration": ["element.quadrature:reduced_gradients"],
    "ray tracing": ["contact.search.projection:ray_tracing"],
    "cut facets": ["contact.segmentation.overlaps", "contact.segmentation.pieces"],
    "cut facets of the plane": ["contact.segmentation.pieces"],
    "smooth geometry": [
        "contact.surface.smooth_geometry:SmoothSurface.__init__",
        "contact.surface.smooth_geometry:SmoothSurface.offset",
    ],
    "inertia in snaps": ["assembly.inertia:Snap.__init__"],
    "orthotropic materials": [
        "assembly.strains:add_stiffness", "contact.traction.small:_LinearRows.__init__",
        "material.orthotropic:Orthotropic.__init__", "material.orthotropic:Orthotropic.deviation",
    ],
    "laws from outside": ["material.laws:PointLaw.__init__"],
    "loads": ["assembly.loads", "assembly.patches"],
    "total loads": ["assembly.coupling"],
    "means of groups": ["assembly.coupling:AverageCoupling.__init__"],
    "expressions": ["scene.expressions"],
    "turning": ["space.supports:Turn.__init__"],
    "groups by place": ["mesh.raw:facets_by_place"],
    "slip": ["contact.history:SlipPath.__init__"],
    "error estimate": ["estimate.estimator", "estimate.local", "io.error_estimate"],
    "energy": ["stepping.energy"],
    "fields": ["io.fields", "io.vtu"],
    "smooth fields": ["io.snapshot:NodeMeans.__init__"],
    "fields in one file": ["io.fields:write_step"],
    "checkpoints": ["io.checkpoint", "mesh.mesh:mesh_digest", "mesh.mesh:hashes", "mesh.mesh:total"],
    "probes": ["stepping.record:Recorder._probe"],
    "sizes of load steps": ["stepping.schedule:Schedule._follow"],
    "bodies that come and go": ["scene.phases:scene_of"],
    "an error to reach": ["adapt.loop", "mesh.refinement.refine"],
    "geometry": ["mesh.geometry.belonging", "mesh.geometry.moving"],
}
KEYS = {
    "Scene": {ANY: "title allow_unsafe", "an error to reach": "accuracy"},
    "Target": {"an error to reach": "error of pictures details"},
    "Budget": {"an error to reach": "unknowns memory time"},
    "MeshSpec": {
        ANY: "file order kinematics", "mean dilatation": "mean_dilatation", "serendipity": "serendipity",
        "finite strain": "strain", "geometry": "geometry",
    },
    "Material": {
        ANY: "E nu", "plasticity": "yield_stress hardening kinematic_hardening hardening_curve",
        "finite strain": "law mooney_rivlin ogden split", "thermal strain": "expansion", "inertia": "density",
        "orthotropic materials": "G axes angle point axis", "laws from outside": "parameters",
    },
    "Body": {
        ANY: "region material", "finite strain": "strain", "reduced integration": "integration", "equations": "order",
        "bodies that come and go": "phases",
        "inertia": "initial_velocity initial_displacement mass_damping stiffness_damping",
    },
    "Contact": {
        ANY: "source target surfaces traction name bilateral theta gamma0 alpha adjoint quadrature search_radius "
             "interference",
        "friction": "friction tresca friction_limit adhesion law stick_stiffness",
        "friction that varies": "kinetic_friction friction_decay", "unbiased contact": "unbiased",
        "all surfaces": "all", "self contact": "self_contact", "tied surfaces": "tied",
        "penalty": "formulation", "cut facets": "cut", "cut facets of the plane": "", "ray tracing": "search",
        "initial gaps": "adjust_within clearance interference_amplitude", "soft layers": "pressure_overclosure",
        "smooth geometry": "smooth_geometry", "phases": "phases",
    },
    "Obstacle": {
        "obstacles": "shape point normal center axis radius inside function gradient displacement amplitude angle "
        "pivot turn_axis expression",
        "finite shapes": "width ring_radius half_angle edge_radius", "rigid meshes": "file region",
    },
    "Displacement": {ANY: "region value amplitude absolute", "turning": "angle point axis", "phases": "phases"},
    "Load": {
        "loads": "region pressure traction body_force amplitude acceleration angular_speed axis name",
        "pressure that follows": "follower", "total loads": "force moment point at within", "phases": "phases",
    },
    "Spring": {"springs": "region per_area stiffness name", "phases": "phases"},
    "Temperature": {"thermal strain": "value region reference amplitude", "fields of files": "file field"},
    "Coupling": {"rigid groups": "region point displacement rotation amplitude name", "means of groups": "average",
        "inertia": "mass inertia"},
    "Pretension": {"pre-tension": "region force shortening amplitude name", "phases": "phases"},
    "Equation": {"equations": "terms"},
    "Periodic": {"equations": "region partner translation angle point axis within"},
    "Region": {"groups by place": "name kind where of"},
    "Phase": {"phases": "name duration count friction tied"},
    "Steps": {
        ANY: "end count min_step", "sizes of load steps": "control max_step",
        "viscous stabilisation": "viscous_stabilisation", "inertia in snaps": "through_snaps",
    },
    "Dynamics": {"inertia": "integrator alpha mass step_error phases"},
    "Output": {
        "fields": "fields", "smooth fields": "smooth", "fields in one file": "format compression",
        "checkpoints": "checkpoint checkpoint_every", "probes": "probes", "energy": "energy",
        "error estimate": "estimate", "slip": "slip",
    },
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
