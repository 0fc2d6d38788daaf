"""Every key of a scene belongs to what any run has, or to a feature; a run without the feature calls nothing of it.

Pieces of physics are those of `test_lean`, which takes each of them out of the program. The others are here: which
modules and functions are theirs alone. One run of a plain scene says what it calls; a run with the feature calls more.
A new key has to be put into ``KEYS``.
"""

import importlib
import json
import sys
from dataclasses import replace

import pytest

from meshes.blocks import two_blocks
from pcontact.runtime.jit import CALLS
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.keys import keys
from pcontact.scene.model import HEADERS, Load, Material
from pcontact.simulation import Simulation
from tests.support.lean import PIECES, scene

# any run has it, or it is a number, a name or a choice of what the run has anyway
ANY = "any run"
# modules of the kernels that a plain run calls, and what its report says of a load step
KERNELS = {
    "averages", "bulk", "complete", "components", "curve", "distortion_kernels", "elastic", "facet_maps",
    "frictionless_kernels", "geometry", "graph", "groups", "matrix", "nearest", "outer", "points", "slices", "trace",
    "tree", "unjoined",
}  # fmt: skip
SECTIONS = {
    "time", "newton", "krylov", "krylov_most", "cutbacks", "reactions", "contacts", "probes", "plastic", "small_strain",
    "imbalance",
}  # fmt: skip
# modules, or functions of them, below the package, that only a run with the feature calls
FEATURES = {
    "serendipity": ["mesh.complete:without_middles"],
    "reduced integration": ["element.reduced"],
    "ray tracing": ["contact.search.projection:ray_tracing"],
    "cut facets": ["contact.segmentation.clipping", "contact.segmentation.overlaps", "contact.segmentation.pieces"],
    "smooth geometry": [
        "contact.surface.smooth_geometry:SmoothSurface.__init__",
        "contact.surface.smooth_geometry:SmoothSurface.offset",
    ],
    "orthotropic materials": ["assembly.orthotropic", "contact.traction.orthotropic", "material.orthotropic"],
    "loads": ["assembly.loads", "assembly.patches"],
    "total loads": ["assembly.coupling"],
    "expressions": ["scene.expression"],
    "turning": ["space.turn"],
    "error estimate": ["estimate.estimator", "estimate.local", "estimate.recovery", "io.error_estimate"],
    "energy": ["stepping.energy"],
    "fields": ["io.fields", "io.vtu", "io.parts"],
    "smooth fields": ["io.smooth"],
    "fields in one file": ["io.hdf_fields", "io.vtkhdf"],
    "checkpoints": ["io.checkpoint", "mesh.digest"],
    "probes": ["stepping.record:Recorder._probe"],
    "sizes of load steps": ["stepping.schedule:Schedule._follow"],
    "bodies that come and go": ["scene.phases:scene_of"],
    "an error to reach": ["adapt.loop", "mesh.refinement.refine"],
}
KEYS = {
    "Scene": {ANY: "title allow_unsafe", "an error to reach": "accuracy"},
    "Target": {"an error to reach": "error of"},
    "Budget": {"an error to reach": "unknowns memory time"},
    "MeshSpec": {
        ANY: "file order kinematics", "mean dilatation": "mean_dilatation", "serendipity": "serendipity",
        "finite strain": "strain",
    },
    "Material": {
        ANY: "E nu", "plasticity": "yield_stress hardening kinematic_hardening hardening_curve",
        "finite strain": "law mooney_rivlin ogden split", "thermal strain": "expansion", "loads": "density",
        "orthotropic materials": "G axes angle point axis",
    },
    "Body": {
        ANY: "region material", "finite strain": "strain", "reduced integration": "integration", "equations": "order",
        "bodies that come and go": "phases",
    },
    "Contact": {
        ANY: "source target name bilateral theta gamma0 alpha adjoint quadrature search_radius interference",
        "friction": "friction tresca friction_limit adhesion law stick_stiffness",
        "friction that varies": "kinetic_friction friction_decay", "unbiased contact": "unbiased",
        "all surfaces": "all", "self contact": "self_contact", "tied surfaces": "tied",
        "penalty": "formulation", "cut facets": "cut", "ray tracing": "search",
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
    "Coupling": {"rigid groups": "region point displacement rotation amplitude name"},
    "Pretension": {"pre-tension": "region force shortening amplitude name", "phases": "phases"},
    "Equation": {"equations": "terms"},
    "Periodic": {"equations": "region partner translation angle point axis within"},
    "Phase": {"phases": "name duration count friction tied"},
    "Steps": {
        ANY: "end count min_step", "sizes of load steps": "control max_step",
        "viscous stabilisation": "viscous_stabilisation",
    },
    "Output": {
        "fields": "fields", "smooth fields": "smooth", "fields in one file": "format compression",
        "checkpoints": "checkpoint checkpoint_every", "probes": "probes", "energy": "energy",
        "error estimate": "estimate",
    },
}  # fmt: skip


def with_feature(path, feature):
    """The plain scene with a feature; None where the boxes of the plain scene cannot show it."""
    result = scene(path)
    (pair,) = result.contacts
    tables = {
        "serendipity": ("mesh", {"order": 2, "serendipity": True}),
        "fields": ("output", {"fields": True}),
        "smooth fields": ("output", {"fields": True, "smooth": True}),
        "fields in one file": ("output", {"fields": True, "format": "vtkhdf"}),
        "checkpoints": ("output", {"checkpoint": True}),
        "probes": ("output", {"probes": ["upper_left"]}),
        "energy": ("output", {"energy": True}),
        "error estimate": ("output", {"estimate": True}),
        "sizes of load steps": ("steps", {"control": "auto"}),
    }
    loads = {
        "loads": Load("upper_left", pressure=0.01), "total loads": Load("upper_left", force=[0.0, 0.01, 0.0]),
        "expressions": Load("upper_left", pressure="0.01*t"), "turning": Load("upper_left", moment=[0.0, 0.01, 0.0]),
    }  # fmt: skip
    if feature in tables:
        name, more = tables[feature]
        setattr(result, name, replace(getattr(result, name), **more))
    elif feature in loads:
        result.loads = [loads[feature]]
    elif feature == "reduced integration":
        result = with_feature(path, "serendipity")
        result.bodies = [replace(body, integration="reduced") for body in result.bodies]
    elif feature == "ray tracing":
        result.contacts = [replace(pair, search="ray_tracing")]
    elif feature == "cut facets":
        result.contacts = [replace(pair, cut=True)]
    elif feature == "orthotropic materials":
        result.materials["soft"] = Material([1000.0, 900.0, 800.0], [0.3] * 3, G=[300.0] * 3)
    else:
        return None
    return result


def run(case, folder):
    """What a run calls, as module:function below the package."""
    called = set()

    def note(frame, event, _):
        if event == "call" and "/pcontact/" in frame.f_code.co_filename:
            module = frame.f_code.co_filename.rpartition("/pcontact/")[2].removesuffix(".py").replace("/", ".")
            called.add(f"{module}:{frame.f_code.co_qualname}")

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        simulation = Simulation(case, MPI.COMM_SELF)
        try:
            assert simulation.run(folder)
        finally:
            simulation.close()
    finally:
        sys.setprofile(before)
    return called


def named(called, entries):
    """The entries, modules or functions, that were called."""
    return {one for one in entries if any(found == one or found.startswith(f"{one}:") for found in called)}


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    path = tmp_path_factory.mktemp("lean") / "blocks.msh"
    on_root(MPI.COMM_SELF, two_blocks, path, 3, 2, 3, "hexahedron")
    return path


@pytest.fixture(scope="module")
def plain(mesh):
    """What a plain run calls."""
    return run(scene(mesh), mesh.parent / "plain")


@pytest.mark.parametrize("cls", HEADERS, ids=lambda cls: cls.__name__)
def test_every_key_has_a_place(cls):
    groups = KEYS.get(cls.__name__, {})
    said = [key for words in groups.values() for key in words.split()]
    assert sorted(said) == sorted(keys(cls)), "each key once: a new one needs a feature, and what is its alone"
    assert groups.keys() <= {ANY, *PIECES, *FEATURES}


@pytest.mark.parametrize("feature", FEATURES)
def test_a_plain_run_calls_nothing_of_it(plain, feature):
    assert not named(plain, FEATURES[feature])


def test_every_feature_has_a_key():
    used = {group for groups in KEYS.values() for group in groups}
    assert set(FEATURES) - used <= {"expressions"}


@pytest.mark.parametrize("feature", FEATURES)
def test_a_run_with_it_calls_it(mesh, plain, feature):
    """The other way round: what is listed is what the feature needs, and counts its kernels."""
    case = with_feature(mesh, feature)
    if case is None:
        # where it is shown instead, so that its names cannot outlive the code
        modules = {entry.partition(":")[0] for entry in FEATURES[feature]}
        assert all(importlib.import_module(f"pcontact.{module}") for module in modules)
        return
    called = run(case, mesh.parent / feature.replace(" ", "_"))
    assert named(called, FEATURES[feature]) == set(FEATURES[feature])
    assert called - plain


def test_objects_of_a_plain_run(mesh):
    """Two items, kernels of elasticity and of frictionless contact, no file but report and history."""
    folder = mesh.parent / "objects"
    before = CALLS.copy()
    simulation = Simulation(scene(mesh), MPI.COMM_SELF)
    try:
        assert simulation.run(folder)
        kernels = {name.partition(".")[0] for name in CALLS - before}
        assert [type(item).__name__ for item in simulation.problem.items] == ["ElasticBulk", "ContactPair"]
    finally:
        simulation.close()
    report = json.loads((folder / "report.json").read_text())
    assert {path.name for path in folder.iterdir()} == {"report.json", "history.csv"}
    assert kernels <= KERNELS, kernels - KERNELS
    assert report["steps"][0].keys() == SECTIONS
