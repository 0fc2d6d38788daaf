"""The Python API: scenes made, read and run in memory. ``import pcontact as pc`` has its names.

A run is a function call: it writes nothing unless asked, reads no command line, has PETSc options of its own, shows
nothing, raises what goes wrong, and leaves nothing behind but what it returns.
"""

# ruff: noqa: E402
from pcontact.runtime import process

# before PETSc starts: the command line is the caller's
process.as_library()

from pcontact.api.fields import Fields
from pcontact.api.meshes import mesh_from
from pcontact.api.problem import Problem, problem
from pcontact.api.results import ContactResult, Picture, Run, load
from pcontact.api.running import Step, run
from pcontact.api.scenes import Scene, from_dict, new, read
from pcontact.api.study import Study, study
from pcontact.api.tables import Table
from pcontact.assembly.item import ActiveSet, Item
from pcontact.contact.law import FrictionLaw, add_law
from pcontact.material.laws import PointLaw, add_material
from pcontact.scene.model import (
    Body,
    Contact,
    Coupling,
    Displacement,
    Dynamics,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Phase,
    Pretension,
    Region,
    Spring,
    Steps,
    Temperature,
)

__all__ = [
    "ActiveSet", "Body", "Contact", "ContactResult", "Coupling", "Displacement", "Dynamics", "Fields", "FrictionLaw",
    "Item", "Load", "Material", "MeshSpec", "Obstacle", "Output", "Phase", "Picture", "PointLaw", "Pretension",
    "Problem", "Region", "Run", "Scene", "Spring", "Step", "Steps", "Study", "Table", "Temperature", "add_law",
    "add_material", "from_dict", "load", "mesh_from", "new", "problem", "read", "run", "study",
]  # fmt: skip
