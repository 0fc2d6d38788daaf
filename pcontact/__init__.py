"""Frictional contact between elastic bodies with Nitsche's method, in parallel on PETSc.

From Python::

    import pcontact as pc
    run = pc.run(pc.read("scene.toml"))

What this needs is imported when it is first asked for: importing a part of the package does not start MPI.
"""

from importlib import import_module

__version__ = "0.1.0"

_API, _ERRORS = "pcontact.api", "pcontact.runtime.errors"
_NAMES = (
    "ActiveSet", "Body", "Contact", "ContactResult", "Coupling", "Displacement", "Dynamics", "Fields", "FrictionLaw",
    "Item", "Load", "Material", "MeshSpec", "Obstacle", "Output", "Phase", "Picture", "PointLaw", "Pretension",
    "Problem", "Region", "Run", "Scene", "Spring", "Step", "Steps", "Study", "Table", "Temperature", "add_law",
    "add_material", "from_dict", "load", "mesh_from", "new", "problem", "read", "run", "study",
)  # fmt: skip
# where the names of the Python API are at home
_HOMES = {
    **dict.fromkeys(_NAMES, _API),
    **dict.fromkeys(("InputError", "OutputError", "NotConverged"), _ERRORS),
}


def __getattr__(name):
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__():
    return sorted({*globals(), *_HOMES})
