"""From the materials of a scene to their laws of small strain: a row for each, of which the first that answers counts;
and the laws that programs add.
"""

from pcontact.material.elastic import Elastic
from pcontact.material.orthotropic import Orthotropic
from pcontact.material.plastic import Plastic

LAWS = {"orthotropic": Orthotropic.of, "plastic": Plastic.of, "elastic": Elastic.of}

# laws that programs have added, by the name that a material says with `law`
ADDED = {}


def add_material(name, make):
    """Add a stress-strain law of small strain: materials of scenes of this process choose it with ``law = "NAME"``.

    Parameters
    ----------
    name : str
    make : callable
        From a :class:`pcontact.scene.model.Material`, the dimension of the mesh and its kinematics to a law: a subclass
        of :class:`pcontact.material.point_law.PointLaw`, or a function.
    """
    ADDED[name] = make


def small_strain(material, dim, kinematics):
    """The law of small strain of a material.

    Parameters
    ----------
    material : pcontact.scene.model.Material
    dim : int
        Of the mesh.
    kinematics : str
        "plane_strain" in space.

    Returns
    -------
    pcontact.material.elastic.Elastic
    """
    if material.added:
        return ADDED[material.law](material, dim, kinematics)
    return next(law for law in (make(material, dim, kinematics) for make in LAWS.values()) if law is not None)
