"""Geometries of meshes of `meshes`, as text for gmsh: of its own kernel and of OpenCASCADE."""

# of an octant and of a quarter, bodies of radii r > q > s, the outer one first
_TWO = """SetFactory("OpenCASCADE");
{shape}(1) = {{{at}, {r}, {angles}}};
{shape}(2) = {{{at}, {q}, {angles}}};
{shape}(3) = {{{at}, {q}, {angles}}};
{shape}(4) = {{{at}, {s}, {angles}}};
BooleanDifference{{ Volume{{1}}; Delete; }}{{ Volume{{2}}; Delete; }}
BooleanDifference{{ Volume{{3}}; Delete; }}{{ Volume{{4}}; Delete; }}
"""


def rings(radii=(1.0, 0.6, 0.2), delta=0.0, kernel="Built-in"):
    """A quarter of two rings, see :func:`meshes.rings`."""
    large, middle, small = radii
    text = f'SetFactory("{kernel}");\nPoint(1) = {{0, 0, 0}};\n'
    for k, r in enumerate((large, middle, middle + delta, small)):
        text += f"Point({10 * k + 11}) = {{{r!r}, 0, 0}};\nPoint({10 * k + 12}) = {{0, {r!r}, 0}};\n"
        text += f"Circle({k + 1}) = {{{10 * k + 11}, 1, {10 * k + 12}}};\n"
    for n, (out, hole) in enumerate(((0, 1), (2, 3))):
        text += f"Line({20 + 2 * n}) = {{{10 * hole + 11}, {10 * out + 11}}};\n"
        text += f"Line({21 + 2 * n}) = {{{10 * hole + 12}, {10 * out + 12}}};\n"
        text += f"Curve Loop({n + 1}) = {{{20 + 2 * n}, {out + 1}, -{21 + 2 * n}, -{hole + 1}}};\n"
        text += f"Plane Surface({n + 1}) = {{{n + 1}}};\n"
    return text


def shells(radii=(1.0, 0.6, 0.3)):
    """Eighths of two spherical shells, see :func:`meshes.shells.shells`."""
    r, q, s = radii
    return _TWO.format(shape="Sphere", at="0, 0, 0", r=r, q=q, s=s, angles="0, Pi/2, Pi/2")


def tubes(radii=(1.0, 0.6, 0.2), height=0.3):
    """Quarters of two tubes, see :func:`meshes.shells.tubes`."""
    r, q, s = radii
    return _TWO.format(shape="Cylinder", at=f"0, 0, 0, 0, 0, {height}", r=r, q=q, s=s, angles="Pi/2")
