"""The fields that a run writes: their names, units and meanings, declared once.

The table of docs/results.md follows from it (``scripts/reference.py``), and pages may name no other field.
"""

from typing import NamedTuple

CHECKPOINT = "checkpoint.h5"


class Field(NamedTuple):
    """A field.

    Attributes
    ----------
    name : str
    place : str
        "nodes" and "cells" of the bodies, "facets" of the contact surfaces, "points", their quadrature points.
    unit : str
    help : str
        One line.
    when : str
        Where it is there; empty: always.
    begin : float or None
        Its value in the undeformed bodies, without forces; None: what it is there.
    """

    name: str
    place: str
    unit: str
    help: str
    when: str = ""
    begin: float | None = 0.0


# of points by the numbers of the field `status`
STATUS = ("open", "stick", "slip")
_FINITE, _YIELD, _SMOOTH, _ESTIMATE = "finite strain", "a body may yield", "`smooth = true`", "`estimate = true`"
_SLIP = "friction, `slip = true`"

_AVERAGED = (
    Field("stress", "cells", "stress", "XX, YY, ZZ, XY, YZ, XZ, mean of the cell; with finite strain Cauchy's"),
    Field("equivalent_stress", "cells", "stress", "von Mises' stress of that mean"),
    Field("equivalent_plastic_strain", "cells", "", "accumulated, mean of the cell", _YIELD),
    Field("log_strain", "cells", "", "logarithmic strain ln V, components as of the stress", _FINITE),
    Field("stretch_1", "cells", "", "largest principal stretch", _FINITE, 1.0),
    Field("stretch_2", "cells", "", "middle principal stretch", _FINITE, 1.0),
    Field("stretch_3", "cells", "", "smallest principal stretch", _FINITE, 1.0),
    Field("rotation", "cells", "degrees", "axis times angle", _FINITE),
)
FIELDS = (
    Field("displacement", "nodes", "length", "of the nodes; also on the contact surfaces"),
    Field("velocity", "nodes", "length / time", "of the nodes", "`[dynamics]`"),
    Field("acceleration", "nodes", "length / time^2", "of the nodes", "`[dynamics]`"),
    Field("node_number", "nodes", "", "number of the node in the mesh, from 0", begin=None),
    *_AVERAGED,
    Field("error_estimate", "cells", "sqrt(energy)", "of the error in the energy norm", _ESTIMATE),
    Field("cell_number", "cells", "", "number of the cell in the mesh, from 0", _ESTIMATE, None),
    Field("body", "cells", "", "number of the body in the scene, from 0", begin=None),
    Field("rank", "cells", "", "which rank has the cell", begin=None),
    *(one._replace(name=f"{one.name}_smooth", place="nodes", help=f"`{one.name}`, averaged in each body",
                   when=", ".join(filter(None, [_SMOOTH, one.when]))) for one in _AVERAGED),
    Field("contact_pressure", "facets", "stress", "mean over the facet"),
    Field("gap", "facets", "length", "mean over the facet; negative where bodies overlap", begin=None),
    Field("status", "facets", "", "what most of the closed points do: 0 open, where none is closed, 1 stick, 2 slip"),
    Field("area", "facets", "area", "of the facet, as far as it has points", begin=None),
    Field("slip", "facets", "length", "magnitude of the slip of the load step, mean over the facet", _SLIP),
    Field("slip_total", "facets", "length", "sum of these over the load steps", _SLIP),
    Field("wear_per_coefficient", "facets", "stress * length", "integral of the pressure over the slip so far: times a "
          "coefficient of wear the depth that is worn off", _SLIP),
    Field("displacement", "points", "length", "of the source"),
    Field("pressure", "points", "stress", "contact pressure"),
    Field("gap", "points", "length", "to the partner; negative where bodies overlap", begin=None),
    Field("traction", "points", "stress", "that acts on the source, a vector"),
    Field("normal", "points", "", "from the source to the target, a vector", begin=None),
    Field("status", "points", "", "0 open, 1 stick, 2 slip"),
    Field("weight", "points", "area", "area that the point stands for", begin=None),
    Field("paired", "points", "", "1 where the point has a partner", begin=None),
    Field("slip", "points", "length", "magnitude of the slip of the load step, 0 where the point does not slide at its "
          "end", _SLIP),
    Field("slip_total", "points", "length", "sum of these over the load steps", _SLIP),
    Field("wear_per_coefficient", "points", "stress * length", "as of the facets", _SLIP),
)  # fmt: skip
# of the undeformed bodies, by name; of one name all fields are alike
BEGIN = {field.name: field.begin for field in FIELDS}
# endings of names in pictures: components of vectors and of symmetric tensors
COMPONENTS = ("x", "y", "z", "xx", "yy", "zz", "xy", "yz", "xz")


def known(name):
    """Return whether a picture may be asked for a field, or a component of one, by this name."""
    names = {field.name for field in FIELDS}
    bare, _, ending = name.rpartition("_")
    return name in names or name == "mesh" or (bare in names and ending in COMPONENTS)


def forces_of(kinematics, dim):
    """Return all forces of the report, and the names of their components.

    Parameters
    ----------
    kinematics : str
        Of the mesh.
    dim : int

    Returns
    -------
    dict
        ``per`` and ``components``. With axial symmetry radial forces balance each other: their sum over the
        circumference is no resultant, and is called another name.
    """
    if dim == 3:
        return {"per": "body", "components": ["x", "y", "z"]}
    if kinematics == "axisymmetric":
        return {"per": "whole circumference", "components": ["radial_sum", "axial_force"]}
    return {"per": "unit thickness", "components": ["x", "y"]}
