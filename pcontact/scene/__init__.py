"""What the user describes: dataclasses, the TOML reader and the checks. Neither PETSc nor MPI."""

from pcontact.scene.amplitude import Amplitude, amplitude, amplitude_of
from pcontact.scene.describe import describe, differences, physics, physics_so_far
from pcontact.scene.functions import obstacle_functions, require_no_code
from pcontact.scene.model import (
    Body,
    Contact,
    Coupling,
    Displacement,
    Dynamics,
    Equation,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Periodic,
    Phase,
    Pretension,
    Region,
    Scene,
    Spring,
    Steps,
    Temperature,
)
from pcontact.scene.reader import read_scene, scene_from
from pcontact.scene.regions import check_apart, check_dimension, check_lost, check_radius, check_regions
from pcontact.scene.validate import resolve_contacts, validate

__all__ = [
    "Amplitude",
    "Body",
    "Contact",
    "Coupling",
    "Displacement",
    "Dynamics",
    "Equation",
    "Load",
    "Material",
    "MeshSpec",
    "Obstacle",
    "Output",
    "Periodic",
    "Phase",
    "Pretension",
    "Region",
    "Scene",
    "Spring",
    "Steps",
    "Temperature",
    "amplitude",
    "amplitude_of",
    "check_apart",
    "check_dimension",
    "check_lost",
    "check_radius",
    "check_regions",
    "describe",
    "differences",
    "obstacle_functions",
    "physics",
    "physics_so_far",
    "read_scene",
    "require_no_code",
    "resolve_contacts",
    "scene_from",
    "validate",
]
