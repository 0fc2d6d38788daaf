"""Input that is wrong, with what the program must say of it; used by several tests."""

from dataclasses import dataclass, field

# -- a mesh of two quadrilaterals and its scene ----------------------------------------

NODES = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 1), (1, 1), (1, 2), (0, 2)]
NAMES = {
    (2, 1): "lower",
    (2, 2): "upper",
    (1, 3): "lower_bottom",
    (1, 4): "lower_top",
    (1, 5): "upper_bottom",
    (1, 6): "upper_top",
    (1, 7): "lower_left",
}
# gmsh type, group, nodes, and the entity if it is not the group's
CELLS = [(3, 1, (1, 2, 3, 4)), (3, 2, (5, 6, 7, 8))]
FACETS = [(1, 3, (1, 2)), (1, 4, (3, 4)), (1, 5, (5, 6)), (1, 6, (7, 8)), (1, 7, (4, 1))]
SCENE = """\
title = "two squares"
[mesh]
file = "mesh.msh"
[materials.m]
E = 1000.0
nu = 0.3
[[bodies]]
region = "lower"
material = "m"
[[bodies]]
region = "upper"
material = "m"
[[contacts]]
name = "pair"
source = "upper_bottom"
target = "lower_top"
[[displacements]]
region = "lower_bottom"
value = [0.0, 0.0]
[[displacements]]
region = "upper_top"
value = [0.0, -0.05]
"""

PHASES = '[[phases]]\nname = "on"\n[[phases]]\nname = "off"\n'


def mesh_text(nodes=None, elements=None, names=None):
    """A gmsh file (MSH 2.2, text)."""
    nodes, names = nodes or NODES, names or NAMES
    elements = elements or CELLS + FACETS
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(names))]
    lines += [f'{dim} {tag} "{name}"' for (dim, tag), name in names.items()]
    lines += ["$EndPhysicalNames", "$Nodes", str(len(nodes))]
    lines += [f"{k + 1} {x} {y} 0" for k, (x, y) in enumerate(nodes)]
    lines += ["$EndNodes", "$Elements", str(len(elements))]
    for k, (kind, group, corners, *entity) in enumerate(elements):
        lines.append(" ".join(map(str, [k + 1, kind, 2, group, *(entity or [group]), *corners])))
    return "\n".join([*lines, "$EndElements", ""])


def swapped(old, new):
    """The scene with one text replaced."""
    assert old in SCENE
    return SCENE.replace(old, new, 1)


# one body of two cells, the facet between them is in a contact surface
INNER = mesh_text(
    NODES[:4] + NODES[6:],
    [
        (3, 1, (1, 2, 3, 4)),
        (3, 2, (4, 3, 5, 6)),
        (1, 3, (1, 2)),
        (1, 4, (3, 4)),
        (1, 5, (3, 5)),
        (1, 6, (5, 6)),
    ],
)


@dataclass
class Case:
    """Input that is wrong.

    Parameters
    ----------
    parts : list of str
        Regular expressions that the line on stderr must match, in any order.
    scene, mesh : str or None
        Contents of the files; None: there is no such file.
    functions : str or None
        Contents of functions.py.
    words : list of str
        Command line; SCENE stands for the scene file.
    """

    parts: list
    scene: str | None = SCENE
    mesh: str | None = field(default_factory=mesh_text)
    words: tuple = ("run", "SCENE")
    functions: str | None = None


def level_set(code, more=""):
    """A case whose obstacle is a function with some code. The points are on one rank of three."""
    where = [r"scene\.toml", r"contacts\[0\] \(pair\)\.obstacle\.function", "'functions.py:phi'", "allowed"]
    scene = swapped('target = "lower_top"', 'obstacle = {shape = "level_set", function = "functions.py:phi"}')
    functions = f"import numpy as np\ndef phi(x, t):\n    {code}\n"
    return Case([*where, *([more] if more else [])], scene=scene, functions=functions)


def expression(text, *parts):
    """A case whose obstacle is an expression."""
    obstacle = f'obstacle = {{shape = "level_set", expression = "{text}"}}'
    where = [r"scene\.toml", r"contacts\[0\] \(pair\)\.obstacle\.expression", "allowed"]
    return Case([*where, *parts], scene=swapped('target = "lower_top"', obstacle))


def shape(keys, *parts):
    """A case whose obstacle has some keys."""
    where = [r"scene\.toml", r"contacts\[0\] \(pair\)\.obstacle", "allowed"]
    return Case([*where, *parts], scene=swapped('target = "lower_top"', f"obstacle = {{{keys}}}"))


def option(parts, *words):
    """A case of a good scene with options."""
    return Case([*parts, "allowed"], words=("run", "SCENE", *words))


CASES = {
    "no scene": Case([r"scene\.toml", "no such file", "allowed: a scene file"], scene=None),
    "no TOML": Case(
        [r"scene\.toml", r"line \d+, column \d+", "TOML"], scene=swapped("E = 1000.0", "E = = 1")
    ),
    "no mesh": Case([r"scene\.toml", r"mesh\.file", "mesh.msh", "no such file", "allowed"], mesh=None),
    "mesh is something else": Case(
        [r"mesh\.msh", "not a gmsh mesh"], mesh="solid ball\nfacet normal 0 0 1\n"
    ),
    "misspelt key": Case(
        [r"contacts\[0\] \(pair\)\.targte", "unknown key", "'target'", "allowed"],
        scene=swapped("target =", "targte ="),
    ),
    "least error without a budget": Case(
        [r"accuracy\.error", '"best" without a budget', "allowed: unknowns, memory or time"],
        scene='accuracy = { error = "best" }\n' + SCENE,
    ),
    "no accuracy": Case(
        [r"accuracy\.error", "0.9", "allowed: a part, as 0.02 or 2%"], scene="accuracy = { error = 0.9 }\n" + SCENE
    ),
    "an error of nothing": Case(
        [r"accuracy\.of", "'force:pear'", "the nearest is 'force:pair'", "allowed: force:pair"],
        scene='accuracy = { error = "2%", of = "force:pear" }\n' + SCENE,
    ),
    "no budget": Case(
        [r"accuracy\.budget\.memory", "'16 apples'", "allowed: a number of bytes, or as 16GB"],
        scene='accuracy = { error = 0.1, budget = { memory = "16 apples" } }\n' + SCENE,
    ),
    "a key of no budget": Case(
        [r"accuracy\.budget\.tim", "unknown key", "'time'"],
        scene='accuracy = { error = 0.1, budget = { tim = 3 } }\n' + SCENE,
    ),
    "misspelt table": Case(
        ["displacement", "'displacements'"], scene=SCENE.replace("[[displacements]]", "[[displacement]]")
    ),
    "negative modulus": Case([r"materials\.m\.E", "-1000", "allowed"], scene=swapped("1000.0", "-1000.0")),
    "incompressible": Case([r"materials\.m\.nu", "0.5", "allowed"], scene=swapped("0.3", "0.5")),
    "two laws of hardening": Case(
        [r"materials\.m\.yield_stress", "2.0 together with hardening_curve", "allowed: at most one"],
        scene=swapped("nu = 0.3", "nu = 0.3\nyield_stress = 2.0\nhardening_curve = [[0, 2], [1, 3]]"),
    ),
    "hardening curve that falls": Case(
        [r"materials\.m\.hardening_curve", "stresses decrease in entry 1", "allowed: a list of .*pairs"],
        scene=swapped("nu = 0.3", "nu = 0.3\nhardening_curve = [[0, 2], [1, 1.5]]"),
    ),
    "text for a number": Case(
        [r"materials\.m\.E", "'steel'|\"steel\"", "allowed"], scene=swapped("1000.0", '"steel"')
    ),
    "unknown material": Case(
        [r"bodies\[0\] \(lower\)\.material", "'mm'", "allowed.*m"], scene=swapped('"m"', '"mm"')
    ),
    "three components in 2D": Case(
        [r"displacements\[0\] \(lower_bottom\)\.value", "3 entries", "2D"],
        scene=swapped("[0.0, 0.0]", "[0.0, 0.0, 0.0]"),
    ),
    "missing group": Case(
        [r"scene\.toml", r"contacts\[0\] \(pair\)\.source", "'upper_botom'", "'upper_bottom'", "allowed"],
        scene=swapped('"upper_bottom"', '"upper_botom"'),
    ),
    "group of another kind": Case(
        [r"contacts\[0\] \(pair\)\.target", "'lower'", "cells", "allowed"],
        scene=swapped('"lower_top"', '"lower"'),
    ),
    "empty surface": Case(
        [r"contacts\[0\] \(pair\)\.target", "'lower_top'", "an empty group", "allowed"],
        mesh=mesh_text(elements=CELLS + [f for f in FACETS if f[1] != 4]),
    ),
    "NaN": Case(
        [r"mesh\.msh", "node 3", "not a finite number|not a gmsh mesh|cannot read"],
        mesh=mesh_text([*NODES[:2], ("nan", 1), *NODES[3:]]),
    ),
    "edge without length": Case(
        [r"mesh\.msh", r"cell 1 \(quadrilateral at \(0\.75, 0\.5\)\) has an edge without length", "allowed"],
        mesh=mesh_text([*NODES[:3], (1, "0.99999999999999999"), *NODES[4:]]),
    ),
    "node without cell": Case(
        [r"mesh\.msh", 'group "tip"', r"node 9 at \(3, 3, 0\)", "no cell", "allowed"],
        mesh=mesh_text([*NODES, (3, 3)], CELLS + FACETS + [(15, 8, (9,))], {**NAMES, (0, 8): "tip"}),
        scene=SCENE + '[output]\nprobes = ["tip"]\n',
    ),
    "facet without cell": Case(
        [r"mesh\.msh", 'group "lower_top"', "facet 4 with nodes 1, 3", "no cell", "allowed"],
        mesh=mesh_text(elements=[*CELLS, FACETS[0], (1, 4, (1, 3)), *FACETS[2:]]),
    ),
    "a node fewer than announced": Case(
        [r"mesh\.msh", r"\$Nodes: found more numbers than are announced", "allowed"],
        mesh=mesh_text().replace("$Nodes\n8\n", "$Nodes\n7\n"),
    ),
    "mesh cut short": Case([r"mesh\.msh", "cut short", "allowed"], mesh=mesh_text()[:-120]),
    "inverted cell": Case(
        [r"mesh\.msh", "cell 1", "quadrilateral", "inverted", "allowed"],
        mesh=mesh_text(elements=[(3, 1, (1, 2, 4, 3)), *CELLS[1:], *FACETS]),
    ),
    "cell in no body": Case(
        [r"mesh\.msh", r"cell 2 \(quadrilateral at \(0\.5, 1\.5\)\)", "'upper'", "in no body", "allowed"],
        scene=swapped('[[bodies]]\nregion = "upper"\nmaterial = "m"\n', ""),
    ),
    "cell in two bodies": Case(
        [r"mesh\.msh", "cell 1 ", "'upper'", "'lower'", "allowed: every cell in one body"],
        mesh=mesh_text(elements=[*CELLS, (3, 2, (1, 2, 3, 4), 1), *FACETS]),
    ),
    "surface inside a body": Case(
        [r"mesh\.msh", "'lower_top'", "between two cells", r"cell 1 \(.*\)", "allowed"], mesh=INNER
    ),
    "surfaces that overlap": Case(
        [r"contacts\[0\] \(pair\)\.target", "'lower_top', which has 1 of the facets of 'upper_bottom'", "allowed"],
        mesh=mesh_text(elements=[*CELLS, *FACETS, (1, 4, (5, 6), 5)]),
    ),
    "conflicting supports": Case(
        [r"scene\.toml", r"displacements\[2\] \(lower_left\)\.value", "found 0.1 in direction 0", "point", "allowed"],
        scene=SCENE + '[[displacements]]\nregion = "lower_left"\nvalue = [0.1, "free"]\n',
    ),
    "penalty with an adjoint term": Case(
        [r"scene\.toml", r"contacts\[0\] \(pair\)\.theta", '1 with formulation "penalty"', "allowed: 0"],
        scene=swapped('name = "pair"', 'name = "pair"\nformulation = "penalty"\ntheta = 1'),
    ),
    "adjusted farther without a word": Case(
        [r"scene\.toml: contacts\[0\] \(pair\)\.adjust_within", "0.1 without interference", "allowed: interference"],
        scene=swapped('name = "pair"', 'name = "pair"\nadjust_within = 0.1'),
    ),
    "two words on the gap": Case(
        [r"contacts\[0\] \(pair\)\.clearance", "together with interference", "allowed: nothing: it is adjusted"],
        scene=swapped('name = "pair"', 'name = "pair"\ninterference = "adjust"\nclearance = 0.1'),
    ),
    "amplitude of no overlap": Case(
        [r"contacts\[0\] \(pair\)\.interference_amplitude", "clearance = 0.1", "allowed: clearance < 0"],
        scene=swapped('name = "pair"', 'name = "pair"\nclearance = 0.1\ninterference_amplitude = [[0, 0], [1, 1]]'),
    ),
    "clearance of a surface with itself": Case(
        [r"contacts\[0\] \(pair\)\.clearance", "surfaces that meet anywhere", "allowed: pairs of two surfaces"],
        scene=swapped('target = "lower_top"', 'target = "upper_bottom"\nclearance = 0.1'),
    ),
    "pressure that falls": Case(
        [r"contacts\[0\] \(pair\)\.pressure_overclosure", "in entry 2", "decreases", "allowed: a number > 0"],
        scene=swapped('name = "pair"', 'name = "pair"\npressure_overclosure = [[0, 0], [1, 2], [2, 1]]'),
    ),
    "pressure before it begins": Case(
        [r"contacts\[0\] \(pair\)\.pressure_overclosure", "first pressure is 1", "allowed"],
        scene=swapped('name = "pair"', 'name = "pair"\npressure_overclosure = [[0, 1], [1, 2]]'),
    ),
    "a layer with another formulation": Case(
        [r"contacts\[0\] \(pair\)\.formulation", '"nitsche" with pressure_overclosure', "allowed: nothing"],
        scene=swapped('name = "pair"', 'name = "pair"\nformulation = "nitsche"\npressure_overclosure = 10'),
    ),
    "a layer with an adjoint term": Case(
        [r"contacts\[0\] \(pair\)\.theta", '1 with formulation "penalty"', "allowed: 0"],
        scene=swapped('name = "pair"', 'name = "pair"\ntheta = 1\npressure_overclosure = 10'),
    ),
    "a layer that is tied": Case(
        [r"contacts\[0\] \(pair\)\.pressure_overclosure", "together with tied = true", "allowed: at most one"],
        scene=swapped('name = "pair"', 'name = "pair"\ntied = true\npressure_overclosure = 10'),
    ),
    "sticking without a layer": Case(
        [r"contacts\[0\] \(pair\)\.stick_stiffness", "without pressure_overclosure", "allowed: pressure_overclosure"],
        scene=swapped('name = "pair"', 'name = "pair"\nfriction = 0.1\nstick_stiffness = 10'),
    ),
    "sticking without friction": Case(
        [r"contacts\[0\] \(pair\)\.stick_stiffness", "without friction", "allowed: friction"],
        scene=swapped('name = "pair"', 'name = "pair"\npressure_overclosure = 10\nstick_stiffness = 10'),
    ),
    "updates of multipliers": Case(
        ["-contact_uzawa_rtol", "found '0'", "allowed: a number > 0"],
        scene=swapped('name = "pair"', 'name = "pair"\nformulation = "augmented_lagrangian"'),
        words=("run", "SCENE", "-contact_uzawa_rtol", "0"),
    ),
    "gamma0 below the bound of coercivity": Case(
        [r"contacts\[0\] \(pair\)\.gamma0: found 0\.1, below", r"allowed: >= 0\.25", "-allow_unsafe gamma0"],
        scene=swapped('name = "pair"', 'name = "pair"\ngamma0 = 0.1\ntheta = 0'),
    ),
    "friction with several solutions": Case(
        [r"scene\.toml: contacts\[0\] \(pair\)\.friction: found 5, with", "allowed: <= 3", "-allow_unsafe friction"],
        scene=swapped('name = "pair"', 'name = "pair"\nfriction = 5'),
    ),
    "punch without a size": shape('shape = "punch", point = [0, 1], normal = [0, 1]', "found neither radius nor width"),
    "obstacle without a mesh": shape('shape = "mesh"', "file: found nothing", "allowed: the name of a mesh file"),
    "obstacle whose mesh is not there": shape(
        'shape = "mesh", file = "tool.msh"', r"file: found 'tool\.msh', no such file", "allowed: a mesh file"
    ),
    "obstacle of no group": shape(
        'shape = "mesh", file = "mesh.msh", region = "lower_tip"', "region: found 'lower_tip'", "nearest is 'lower_top'"
    ),
    "obstacle of two surfaces that meet": Case(
        [r"contacts\[0\] \(pair\)\.obstacle\.file: found \d facets of .* that meet at", "allowed: a surface"],
        scene=swapped('target = "lower_top"', 'obstacle = {shape = "mesh", file = "mesh.msh"}'),
        mesh=mesh_text(elements=[*CELLS, *FACETS, (1, 8, (2, 3)), (1, 8, (2, 4))], names={**NAMES, (1, 8): "more"}),
    ),
    "edge rounder than a punch": shape(
        'shape = "punch", point = [0, 0.5], normal = [0, 1], width = 1, edge_radius = 0.6',
        r"edge_radius: found 0\.6, more than half", r"allowed: at most 0\.5",
    ),
    "round punch in the plane": shape(
        'shape = "punch", point = [0, 0.5], normal = [0, 1], radius = 1', "radius: found a round punch with a 2D mesh"
    ),
    "cone in the plane": shape(
        'shape = "cone", point = [0, 0.5], normal = [0, 1], half_angle = 60', 'shape: found "cone" with a 2D mesh'
    ),
    "torus that is no ring": shape(
        'shape = "torus", center = [0, 0, 0], axis = [0, 0, 1], radius = 2, ring_radius = 1',
        r"radius: found 2, more than ring_radius", "allowed: at most ring_radius = 1",
    ),
    "torus without a ring": shape(
        'shape = "torus", center = [0, 0, 0], axis = [0, 0, 1], radius = 2', "ring_radius: found nothing", "allowed"
    ),
    "wedge that is blunt": shape(
        'shape = "wedge", point = [0, 0.5], normal = [0, 1], half_angle = 90', r"half_angle", "90", "allowed: a number"
    ),
    "wedge with an edge in the plane": shape(
        'shape = "wedge", point = [0, 0.5], normal = [0, 1], axis = [1, 0], half_angle = 60',
        "axis: found .* with a 2D mesh", "allowed: nothing, it is known",
    ),
    "friction in words": Case(
        [r"contacts\[0\] \(pair\)\.friction", "the name 'rough' at character 1", "allowed: a number >= 0, or an"],
        scene=swapped('name = "pair"', 'name = "pair"\nfriction = "rough"'),
    ),
    "friction that is negative somewhere": Case(
        [r"scene\.toml: contacts\[0\] \(pair\)\.friction: found '0\.3 - x', the value -0\.\d+ at the point \(",
         "allowed: numbers >= 0"],
        scene=swapped('name = "pair"', 'name = "pair"\nfriction = "0.3 - x"'),
    ),
    "friction with several solutions somewhere": Case(
        [r"contacts\[0\] \(pair\)\.friction: found 3\.9\d*, with", "allowed: <= 3", "-allow_unsafe friction"],
        scene=swapped('name = "pair"', 'name = "pair"\nfriction = "4*x**0.01"'),
    ),
    "kinetic friction without a decay": Case(
        [r"contacts\[0\] \(pair\)\.kinetic_friction: found 0.2 without friction_decay", "as well"],
        scene=swapped('name = "pair"', 'name = "pair"\nfriction = 0.3\nkinetic_friction = 0.2'),
    ),
    "a decay of nothing": Case(
        [r"contacts\[0\] \(pair\)\.friction_decay: found 2.0 without kinetic_friction", "as well"],
        scene=swapped('name = "pair"', 'name = "pair"\nfriction = 0.3\nfriction_decay = 2.0'),
    ),
    "kinetic friction with adhesion": Case(
        [r"contacts\[0\] \(pair\)\.adhesion: found 1.0 together with kinetic_friction", "allowed: at most one"],
        scene=swapped(
            'name = "pair"', 'name = "pair"\nfriction = 0.3\nadhesion = 1\nkinetic_friction = 0.2\nfriction_decay = 1'
        ),
    ),
    "phase of a scene without": Case(
        [r"displacements\[1\] \(upper_top\)\.phases: found \[.on.\] without", r"allowed: \[\[phases\]\] as well"],
        scene=SCENE + 'phases = ["on"]\n',
    ),
    "pre-tension without a value": Case(
        [r"pretensions\[0\] \(lower_top\): found neither force nor", "allowed: exactly one of force, shortening"],
        scene=SCENE + '[[pretensions]]\nregion = "lower_top"\n',
    ),
    "pre-tension on the boundary": Case(
        [r"mesh\.msh: section 'lower_top': found 1 facets, . on one side", "allowed: all facets of a plane across"],
        scene=SCENE + '[[pretensions]]\nregion = "lower_top"\nforce = 1.0\n',
    ),
    "equation without a direction": Case(
        [r"equations\[0\]\.terms|equations\[0\].*terms", r"allowed: a list of at least one \[group"],
        scene=SCENE + '[[equations]]\nterms = [["lower_top", 1, 1.0]]\n',
    ),
    "equation of the third direction": Case(
        [r"equations\[0\] \(lower_top\)\.terms: found direction z with a 2D mesh", "allowed: x, y"],
        scene=SCENE + '[[equations]]\nterms = [["lower_top", "z", 1.0]]\n',
    ),
    "equation of many nodes": Case(
        [r"equations\[0\] \(lower_top\)\.terms: found 'lower_top', a group of 2 nodes", "allowed: groups of one"],
        scene=SCENE + '[[equations]]\nterms = [["lower_top", "x", 1.0]]\n',
    ),
    "periodic groups without a motion": Case(
        [r"periodic\[0\] \(lower_top\): found neither translation nor angle", "allowed: at least one of"],
        scene=SCENE + '[[periodic]]\nregion = "lower_top"\npartner = "lower_bottom"\n',
    ),
    "periodic groups that are none": Case(
        [r"periodic\[0\] \(lower_top\)\.partner: found 'lower_bottom', whose nearest", "allowed: nodes that are pairs"],
        scene=SCENE + '[[periodic]]\nregion = "lower_top"\npartner = "lower_bottom"\ntranslation = [0.0, 0.5]\n',
    ),
    "phase of another name": Case(
        [r"displacements\[1\] \(upper_top\)\.phases: found 'of'", "no such phase", "allowed: off, on"],
        scene=SCENE + 'phases = ["of"]\n' + PHASES,
    ),
    "phase a second time": Case(
        [r"phases\[2\] \(on\)\.name: found 'on' a second time"], scene=SCENE + PHASES + '[[phases]]\nname = "on"\n'
    ),
    "phases and an end": Case(
        [r"steps\.end: found 3.0 together with", "allowed: nothing: the run ends"],
        scene=SCENE + PHASES + "[steps]\nend = 3.0\n"
    ),
    "phase of no contact": Case(
        [r"phases\[1\] \(off\)\.tied: found 'pear'", "no such contact", "allowed: pair"],
        scene=SCENE + PHASES + 'tied = ["pear"]\n',
    ),
    "friction of a phase in words": Case(
        [r"phases\[1\] \(off\)\.friction", "a table of names and numbers >= 0 or expressions"],
        scene=SCENE + PHASES + 'friction = "pair"\n',
    ),
    "contact that ties before it closes": Case(
        [r"phases\[0\] \(on\)\.tied: found 'pair', which does not act in the phase before", "allowed: a contact whose"],
        scene=SCENE + '[[phases]]\nname = "on"\ntied = ["pair"]\n',
    ),
    "turn that begins in a phase": Case(
        [r"displacements\[1\] \(upper_top\)\.phases: found \['off'\] with an angle", "allowed: phases from the first"],
        scene=SCENE + 'angle = 3.0\npoint = [0.0, 0.0]\nphases = ["off"]\n' + PHASES,
    ),
    "body of another phase": Case(
        [r"bodies\[0\] \(lower\)\.phases: found 'of'", "no such phase", "allowed: off, on"],
        scene=SCENE.replace('region = "lower"\n', 'region = "lower"\nphases = ["of"]\n', 1) + PHASES,
    ),
    "phases with an estimate": Case(
        [r"output\.estimate: found true together with \[\[phases\]\]"],
        scene=SCENE + PHASES + "[output]\nestimate = true\n"
    ),
    "unsafe word": Case(
        ["-allow_unsafe", "found 'gama0'", "allowed: some of gamma0, locking, facet_sizes, friction, mesh"],
        words=("run", "SCENE", "-allow_unsafe", "locking,gama0"),
    ),
    "unsafe word of the scene": Case(
        [r"scene\.toml: allow_unsafe", "entry 0 is a string 'gama0'", '"gamma0" \\| "locking"'],
        scene="allow_unsafe = ['gama0']\n" + SCENE,
    ),
    "level set that stops": level_set("raise ValueError('far')", "ValueError: far in line 3 of functions.py"),
    "level set that ends the program": level_set("import sys; sys.exit(1)", "SystemExit"),
    "level set that is not finite": level_set("return np.where(x[:, 0] < 0.5, np.nan, 1.0)", "nan at the point"),
    "level set of complex numbers": level_set("return np.sqrt(x[:, 1] - 0.4 + 0j)", "values of type complex128"),
    "level set of booleans": level_set("return x[:, 1] > 0.0", "values of type bool"),
    "level set that is a program": Case(
        [*level_set("return x[:, 1]").parts[:3], "a program, with -no_code", "allowed: expression"],
        scene=level_set("").scene, functions="raise SystemExit('run')", words=("run", "SCENE", "-no_code", "true"),
    ),
    "expression that runs something": expression("__import__('os').abort()", "a call of something", "character 1"),
    "expression without end": expression("9**9**9**9 + x", "the value inf at the point"),
    "expression without slope": expression("x*0", "its gradient", "zero at all"),
    "expression of space in the plane": expression("z - 1", "z with a 2D mesh", "allowed: x, y, t"),
    "level set twice": Case(
        [r"obstacle\.function: found .functions.py:phi. together with expression"],
        scene=expression("x").scene.replace("shape =", 'function = "functions.py:phi", shape ='), functions="",
    ),
    "level set of another shape": level_set("return x", r"shape \(\d+, 2\)"),
    "control character in a name": Case(
        [r"contacts\[0\] \(pa\\x00ir\)\.name: found a string 'pa\\x00ir', with a control character", "allowed"],
        scene=swapped('"pair"', r'"pa\u0000ir"'),
    ),
    "control character in the name of a material": Case(
        [r"materials: found a string 'm\\x1b', with a control character", "allowed"],
        scene=SCENE.replace("[materials.m]", r'[materials."m\u001b"]').replace('"m"', r'"m\u001b"', 2),
    ),
    "solver of the scene": Case(["-pc_type nonsense", "allowed"], scene=SCENE + "[petsc]\npc_type = 'nonsense'\n"),
    "number of the scene": Case(
        ["scene: petsc: -snes_rtol: found 'abc'", "allowed"], scene=SCENE + "[petsc]\nsnes_rtol = 'abc'\n"
    ),
}
OPTIONS = {
    "theta": option(["command line: -contact_theta: found a number 3"], "-contact_theta", "3"),
    "theta in words": option(["-contact_theta: found 'abc'", "a number"], "-contact_theta", "abc"),
    "order": option(["command line: -mesh_order: found 'x'", r"1 \| 2"], "-mesh_order", "x"),
    "smoothing": option(["command line: -output_smooth: found 'maybe'", "true \\| false"], "-output_smooth", "maybe"),
    "negative steps": option(["command line: -steps_count: found '-2'"], "-steps_count", "-2"),
    "negative weight": option(["command line: -partition_weight: found '-1'"], "-partition_weight", "-1"),
    "ksp": option(["-ksp_type nonsense"], "-ksp_type", "nonsense"),
    "no iterations": option(["-snes_max_it: found '-5'", "a finite number >= 0"], "-snes_max_it", "-5"),
    "no tolerance": option(["-snes_rtol: found 'nan'", "from 0 to below 1"], "-snes_rtol", "nan"),
    "large tolerance": option(["-ksp_rtol: found '2'", "from 0 to below 1"], "-ksp_rtol", "2"),
    "inexact tolerance": option(["-snes_ksp_ew_rtol0: found '5'", "below 1"], "-snes_ksp_ew_rtol0", "5"),
    "direct_below": option(["-pc_direct_below: found '-7'", "an integer >= 0"], "-pc_direct_below", "-7"),
    "searches": option(["-contact_search_again: found '-1'", "an integer >= 0"], "-contact_search_again", "-1"),
    "number that is not finite": option(["-partition_weight: found 'inf'"], "-partition_weight", "inf"),
    "number beyond arithmetic": option(["-contact_gamma0", "between 1e-60 and 1e.60"], "-contact_gamma0", "1e300"),
    "denormal number": Case(
        [r"materials\.m\.E: found a number 1e-320, whose size is not between", "allowed: a number > 0"],
        scene=swapped("1000.0", "1e-320"),
    ),
    "huge entry": Case(
        [r"displacements\[1\] \(upper_top\)\.value", "entry 1 is a number -1e.200, whose size"],
        scene=swapped("-0.05", "-1e200"),
    ),
    "line search": option(["-snes_linesearch_type nonsense"], "-snes_linesearch_type", "nonsense"),
    "smoother": option(["-mg_levels_ksp_type nonsense"], "-mg_levels_ksp_type", "nonsense"),
    "output over a file": option(["-o mesh.msh", "not a directory"], "-o", "mesh.msh"),
    "output nowhere": option(["-o: found nothing", "a directory"], "-o"),
    "order of check": Case(
        ["-mesh_order", "'7'", r"allowed: 1 \| 2"], words=("check", "SCENE", "-mesh_order", "7")
    ),
    "command": Case(
        ["command line", "'rum'", "allowed: run, check, ", "new, demo, warm, doctor, schema",
         "nearest is 'run'"],
        words=("rum", "SCENE"),
    ),
    "no operand": Case(["pcontact run", "no operand", "a scene file"], words=("run",)),
    "two operands": Case(["second operand", "allowed"], words=("run", "SCENE", "SCENE")),
    "view without results": Case(["nowhere", "no such directory"], words=("view", "nowhere")),
}
CASES.update(OPTIONS)
