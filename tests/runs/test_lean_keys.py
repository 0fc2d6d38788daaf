"""Every key of a scene belongs to what any run has, or to a feature; a run without the feature calls nothing of it.

Pieces of physics are those of `test_lean`, which takes each of them out of the program. The others are here: which
modules and functions are theirs alone. One run of a plain scene says what it calls; a run with the feature calls more.
A new key has to be put into ``KEYS`` of `tests.support.lean`.
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
from pcontact.scene.model import Coupling, Displacement, Load, Material
from pcontact.simulation import Simulation
from tests.support.lean import FEATURES, KEYS, scene
from tests.support.point_laws import add_all, remove_all

# modules of the kernels that a plain run calls, and what its report says of a load step
KERNELS = {
    "measures", "elastic", "facet_maps",
    "geometry", "graph", "matrix", "mesh", "operator", "partners", "points", "projection", "raw", "slices",
    "small_kernels", "small", "solid", "strains", "topology", "trace", "tree", "unjoined",
}  # fmt: skip
SECTIONS = {
    "time", "newton", "krylov", "krylov_most", "cutbacks", "reactions", "contacts", "probes", "plastic", "small_strain",
    "partners", "imbalance", "largest",
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
        "expressions": Load("upper_left", pressure="0.01*t"),
    }  # fmt: skip
    if feature in tables:
        name, more = tables[feature]
        setattr(result, name, replace(getattr(result, name), **more))
    elif feature in loads:
        result.loads = [loads[feature]]
    elif feature == "inertia in snaps":
        result.steps = replace(result.steps, through_snaps="dynamic")
        result.materials = {name: replace(one, density=1.0) for name, one in result.materials.items()}
    elif feature == "reduced integration":
        result = with_feature(path, "serendipity")
        result.bodies = [replace(body, integration="reduced") for body in result.bodies]
    elif feature == "means of groups":
        result.displacements = result.displacements[:1]
        result.couplings = [Coupling("upper_top", average=True, displacement=[0.005, 0.0, -0.02])]
    elif feature == "turning":
        result.displacements[1] = Displacement("upper_top", [0.005, 0.0, -0.02], angle=0.1, point=[0.5, 0.5, 2.0],
                                               axis=[0.0, 0.0, 1.0])  # fmt: skip
    elif feature == "ray tracing":
        result.contacts = [replace(pair, search="ray_tracing")]
    elif feature == "cut facets":
        result.contacts = [replace(pair, cut=True)]
    elif feature == "orthotropic materials":
        result.materials["soft"] = Material([1000.0, 900.0, 800.0], [0.3] * 3, G=[300.0] * 3)
    elif feature == "laws from outside":
        add_all()
        result.materials["soft"] = Material(1000.0, 0.3, law="mises", parameters=[8.0, 100.0])
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
    remove_all()
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
        assert [type(item).__name__ for item in simulation.problem.items] == ["Solid", "ContactPair"]
    finally:
        simulation.close()
    report = json.loads((folder / "report.json").read_text())
    assert {path.name for path in folder.iterdir()} == {"report.json", "steps.jsonl", "history.csv"}
    assert kernels <= KERNELS, kernels - KERNELS
    assert report["steps"][0].keys() == SECTIONS
