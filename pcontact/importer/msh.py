"""The files of meshes that an import writes."""

from pcontact.runtime.files import replace_file


def write_msh(path, nodes, elements, names=()):
    """Write a mesh file of gmsh's version 2.2, in which an element stands once for each of its groups. Serial.

    Parameters
    ----------
    path : pathlib.Path
    nodes : iterable of (int, sequence of 3 float)
        Numbers and places [length].
    elements : sequence of (int, int, int, sequence of int)
        Number, gmsh's type, number of the group, and the nodes in gmsh's order.
    names : sequence of (int, int, str)
        Of the groups: dimension, number, name.
    """
    text = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat"]
    if names:
        text += ["$PhysicalNames", str(len(names)), *(f'{d} {k} "{name}"' for d, k, name in names), "$EndPhysicalNames"]
    rows = [f"{number} {' '.join(map(repr, place))}" for number, place in nodes]
    text += ["$Nodes", str(len(rows)), *rows, "$EndNodes", "$Elements", str(len(elements))]
    text += [f"{tag} {kind} 2 {group} {group} {' '.join(map(str, members))}" for tag, kind, group, members in elements]
    replace_file(path, "\n".join([*text, "$EndElements", ""]))
