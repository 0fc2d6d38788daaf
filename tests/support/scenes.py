"""Scene files: with every key, without any that can be left out, and with values that are refused."""

import pytest

# the scene of the contract, with everything that can be said
FULL = """
title = "Half ball on a block"

[mesh]
file = "ball_on_block.msh"
order = 1
kinematics = "plane_strain"  # as in the contract, though the mesh is 3D

[materials.steel]
E = 210e3
nu = 0.3

[materials.aluminium]
E = 70000
nu = 0.3
yield_stress = 250.0
hardening = 1000.0
kinematic_hardening = 0.0

[[bodies]]
region = "block"
material = "aluminium"
[[bodies]]
region = "ball"
material = "steel"

[[contacts]]
name = "ball-block"
source = "ball_skin"
target = "block_top"
friction = 0.3
formulation = "nitsche"
theta = 0
gamma0 = 10
quadrature = 7
unbiased = false
search = "closest_point"
search_radius = 2
interference = "resolve"

[[contacts]]
name = "floor"
source = "block_bottom"
obstacle = { shape = "plane", point = [0, 0, -1], normal = [0, 0, 1] }

[[contacts]]
source = "block_left"
tresca = 5.0
[contacts.obstacle]
shape = "sphere"
center = [-3, 0, 0]
radius = 2
inside = true
displacement = [0, 0, 0.1]
amplitude = [[0, 0], [0.5, 1]]

[[contacts]]
name = "pipe"
source = "block_right"
obstacle.shape = "cylinder"
obstacle.point = [3, 0, 0]
obstacle.axis = [0, 1, 0]
obstacle.radius = 1.5

[[displacements]]
region = "ball_top"
value = ["free", "free", -0.02]
amplitude = [[0, 0], [1, 1]]

[[loads]]
region = "block_top"
pressure = 10.0
[[loads]]
region = "block_left"
traction = [1, 0, 0]
amplitude = [[0, 1]]
[[loads]]
region = "ball"
body_force = [0, 0, -9.81]

[steps]
end = 2
count = 5
min_step = 1e-4

[output]
fields = true
checkpoint = true
probes = ["ball_top", "tip"]

[petsc]
snes_rtol = 1e-8
ksp_type = "cg"
snes_monitor = true
ksp_max_it = 200
"""
PLAIN = """
[mesh]
file = "ball_on_block.msh"
[materials.steel]
E = 1.0
nu = 0.25
[[bodies]]
region = "block"
material = "steel"
[[contacts]]
source = "ball_skin"
target = "block_top"
"""


def value_cases():
    """(text to replace, replacement, key path, found, allowed) in the full scene."""
    steel, alu = "materials.steel", "materials.aluminium"
    pair, floor = "contacts[0] (ball-block)", "contacts[1] (floor)"
    ball, pipe = "contacts[2] (block_left-sphere)", "contacts[3] (pipe)"
    top = "displacements[0] (ball_top)"
    # fmt: off
    cases = [
        ('"Half ball on a block"', "1", "title", "an integer 1", "a string"),
        ('"ball_on_block.msh"', "3", "mesh.file", "an integer 3", "a mesh file"),
        ('"ball_on_block.msh"', '""', "mesh.file", "a string ''", "a mesh file"),
        ('"ball_on_block.msh"', '"ball_on_blok.msh"', "mesh.file", "the nearest is 'ball_on_block.msh'",
         "beside"),
        ('"ball_on_block.msh"', '"."', "mesh.file", "'.', a directory", "beside"),
        ('"ball_on_block.msh"', '"none.msh"', "mesh.file", "'none.msh', no such file", "beside"),
        ("order = 1", "geometry = 3", "mesh.geometry", "an integer 3", "the name of a file .geo"),
        ("order = 1", 'geometry = "ball.msh"', "mesh.geometry", "'ball.msh'", "a file .geo, .geo_unrolled, .brep"),
        ("order = 1", 'geometry = "ball.step"', "mesh.geometry", "'ball.step', no such file", "a geometry beside"),
        ("order = 1", "order = 3", "mesh.order", "an integer 3", "an integer from 1 to 2"),
        ("order = 1", "order = 1.0", "mesh.order", "a number 1.0", "an integer from 1 to 2"),
        ("order = 1", "order = 1\nserendipity = true", "mesh.serendipity", "degree 1", "order = 2"),
        ('material = "steel"', 'material = "steel"\nintegration = "less"', "bodies[1] (ball).integration", "'less'",
         '"full" | "reduced"'),
        ('material = "steel"', 'material = "steel"\nintegration = "reduced"', "bodies[1] (ball).integration",
         '"reduced" without mesh.serendipity', '"full"'),
        ('material = "steel"', 'material = "steel"\norder = 2', "bodies[1] (ball).order", "2 without order = 2",
         "1, or"),
        ('material = "steel"', 'material = "steel"\norder = 3', "bodies[1] (ball).order", "an integer 3",
         "an integer from 1 to 2"),
        ("order = 1", "order = true", "mesh.order", "a boolean true", "an integer from 1 to 2"),
        ('"plane_strain"', '"plain_strain"', "mesh.kinematics", "a string 'plain_strain'",
         '"plane_strain" |'),
        ('kinematics = "plane_strain"', "kinematics = []", "mesh.kinematics", "a list []", '"axisymmetric"'),
        ("E = 210e3", "E = 0", f"{steel}.E", "an integer 0", "a number > 0"),
        ("E = 210e3", "E = -1.5", f"{steel}.E", "a number -1.5", "a number > 0"),
        ("E = 210e3", "E = nan", f"{steel}.E", "a number nan", "a number > 0"),
        ("E = 210e3", "E = inf", f"{steel}.E", "a number inf", "a number > 0"),
        ("E = 210e3", "E = 1e999", f"{steel}.E", "a number inf", "a number > 0"),
        ("E = 210e3", "E = " + "9" * 400, f"{steel}.E", "an integer 999", "a number > 0"),
        ("E = 210e3", 'E = "210e3"', f"{steel}.E", "a string '210e3'", "a number > 0"),
        ("E = 210e3", "E = true", f"{steel}.E", "a boolean true", "a number > 0"),
        ("E = 210e3", "E = [1]", f"{steel}.E", "a list [1]", "a number > 0"),
        ("E = 210e3", "E = {a = 1}", f"{steel}.E", "a table", "a number > 0"),
        ("E = 210e3", "E = 2020-01-01", f"{steel}.E", "a value of type date", "a number > 0"),
        ("nu = 0.3", "nu = 0.5", f"{steel}.nu", "a number 0.5", "use e.g. 0.4999"),
        ("nu = 0.3", "nu = -1", f"{steel}.nu", "an integer -1", "-1 < nu < 0.5"),
        ("yield_stress = 250.0", "yield_stress = 0", f"{alu}.yield_stress", "an integer 0", "a number > 0"),
        ("yield_stress = 250.0", "", f"{alu}.hardening", "1000.0 without yield_stress",
         "yield_stress or hardening_curve as well"),
        ("g = 1000.0", "g = -1", f"{alu}.hardening", "an integer -1", "a number >= 0"),
        ("c_hardening = 0.0", "c_hardening = '0'", f"{alu}.kinematic_hardening", "a string '0'",
         "a number >= 0"),
        ('"aluminium"', '"aluminum"', "bodies[0] (block).material", "the nearest is 'aluminium'",
         "aluminium, steel"),
        ('n = "ball"', 'n = "block"', "bodies[1] (block).region", "a second time, as in bodies[0]",
         "each once"),
        ('n = "ball"', "n = 7", "bodies[1].region", "an integer 7", "a string that is not empty"),
        ('target = "block_top"', 'surfaces = ["ball_skin", "block_top"]', f"{pair}.surfaces",
         "surfaces together with source or target", "at most one of surfaces"),
        ('"ball-block"', '"floor"', "contacts[1] (floor).name", "a second time, as in contacts[0]",
         "each once"),
        ('"ball-block"', "5", "contacts[0].name", "an integer 5", "a string that is not empty"),
        ('"ball-block"', '""', "contacts[0].name", "a string ''", "a string that is not empty"),
        ('"ball_skin"', '["a"]', f"{pair}.source", "a list ['a']", "a string"),
        ('target = "block_top"', "", pair, "neither target nor obstacle", "exactly one of target, obstacle"),
        ('"floor"', '"floor"\ntarget = "a"', floor, "both target and obstacle",
         "exactly one of target, obstacle"),
        ('"floor"', '"floor"\nunbiased = true', f"{floor}.unbiased", "true together with obstacle",
         "nothing: an obstacle has no facets"),
        ("friction = 0.3", 'friction = "abc"', f"{pair}.friction", "a string 'abc'", "a number >= 0"),
        ("friction = 0.3", "friction = -0.1", f"{pair}.friction", "a number -0.1", "a number >= 0"),
        ("friction = 0.3", "friction = 0.3\ntresca = 1", f"{pair}.friction", "0.3 together with tresca", "at most one"),
        ("tresca = 5.0", "tresca = nan", f"{ball}.tresca", "a number nan", "a number >= 0"),
        ('"nitsche"', '"lagrange"', f"{pair}.formulation", "a string 'lagrange'", '"nitsche" | "penalty" |'),
        ('"nitsche"\ntheta = 0', '"penalty"\ntheta = 1', f"{pair}.theta", '1 with formulation "penalty"',
         "0, or"),
        ('"nitsche"\ntheta = 0', '"penalty"\nadjoint = "consistent"', f"{pair}.adjoint",
         "'consistent' with formulation \"penalty\"", "nothing, or"),
        ("theta = 0", "theta = 0.5", f"{pair}.theta", "a number 0.5", "1 | 0 | -1"),
        ("theta = 0", "theta = '0'", f"{pair}.theta", "a string '0'", "1 | 0 | -1"),
        ("gamma0 = 10", "gamma0 = 0", f"{pair}.gamma0", "an integer 0", "a number > 0"),
        ("quadrature = 7", "quadrature = 0", f"{pair}.quadrature", "an integer 0", "an integer from 1 to 20"),
        ("quadrature = 7", "quadrature = 21", f"{pair}.quadrature", "an integer 21",
         "an integer from 1 to 20"),
        ("unbiased = false", "unbiased = 0", f"{pair}.unbiased", "an integer 0", "true | false"),
        ('"closest_point"', '"closest"', f"{pair}.search", "a string 'closest'",
         '"closest_point" | "ray_tracing"'),
        ("search_radius = 2", "search_radius = -2", f"{pair}.search_radius", "an integer -2", "a number > 0"),
        ('"resolve"', '"remove"', f"{pair}.interference", "a string 'remove'", '"resolve" | "adjust"'),
        ('"plane"', '"plain"', f"{floor}.obstacle.shape", "'plain'", '"level_set"'),
        (", normal = [0, 0, 1]", "", f"{floor}.obstacle.normal", "nothing", "not all zero"),
        ("normal = [0, 0, 1]", "normal = [0, 0, 0]", f"{floor}.obstacle.normal", "a list [0, 0, 0]",
         "not all zero"),
        ("normal = [0, 0, 1]", "normal = [1]", f"{floor}.obstacle.normal", "1 entries", "per direction"),
        ("point = [0, 0, -1]", "point = [0, 'a', 1]", f"{floor}.obstacle.point", "entry 1 is a string 'a'",
         "one per direction"),
        ("point = [0, 0, -1]", "point = 0", f"{floor}.obstacle.point", "an integer 0", "a list"),
        ("normal = [0, 0, 1]", "normal = [0, 1], radius = 1", f"{floor}.obstacle.radius", '"plane"',
         "shape, point"),
        ("radius = 2\n", "radius = -2\n", f"{pair}.search_radius", "an integer -2", "a number > 0"),
        ("radius = 2\ninside", "radius = 0\ninside", f"{ball}.obstacle.radius", "an integer 0",
         "a number > 0"),
        ("inside = true", "inside = 'yes'", f"{ball}.obstacle.inside", "a string 'yes'", "true | false"),
        ("displacement = [0, 0, 0.1]", "", f"{ball}.obstacle.amplitude", "without displacement",
         "displacement or angle as well"),
        ("axis = [0, 1, 0]", "axis = [0, 0, 0]", f"{pipe}.obstacle.axis", "a list [0, 0, 0]", "not all zero"),
        ('["free", "free", -0.02]', "-0.02", f"{top}.value", "a number -0.02", '"free"'),
        ('["free", "free", -0.02]', '["fre", 1]', f"{top}.value", "entry 0 is a string 'fre'", '"free"'),
        ('["free", "free", -0.02]', "[1]", f"{top}.value", "1 entries", "2 or 3 entries"),
        ('["free", "free", -0.02]', "[0, nan]", f"{top}.value", "entry 1 is a number nan", '"free"'),
        ("[[0, 0], [1, 1]]", "[[0, 0], [0, 1]]", f"{top}.amplitude", "times do not increase",
         "[time, factor]"),
        ("[[0, 0], [1, 1]]", "[[0, 0], [1]]", f"{top}.amplitude", "entry 1 is a list [1]", "[time, factor]"),
        ("[[0, 0], [1, 1]]", "[]", f"{top}.amplitude", "a list []", "[time, factor]"),
        ("[[0, 0], [1, 1]]", "2", f"{top}.amplitude", "an integer 2", "[time, factor]"),
        ("[[0, 0], [1, 1]]", "[[0, inf]]", f"{top}.amplitude", "entry 0", "[time, factor]"),
        ("pressure = 10.0", "", "loads[0] (block_top)", "none",
         "exactly one of pressure, traction, body_force"),
        ("pressure = 10.0", "pressure = 1\ntraction = [0, 1]", "loads[0] (block_top)",
         "pressure and traction", "exactly"),
        ("pressure = 10.0", "pressure = [1]", "loads[0] (block_top).pressure", "a list [1]",
         "a finite number"),
        ("traction = [1, 0, 0]", "traction = 1", "loads[1] (block_left).traction", "an integer 1", "a list"),
        ("-9.81]", "nan]", "loads[2] (ball).body_force", "entry 2 is a number nan", "a list"),
        ("end = 2", "end = 0", "steps.end", "an integer 0", "a number > 0"),
        ("count = 5", "count = 0", "steps.count", "an integer 0", "an integer from 1 to 1000000"),
        ("count = 5", "count = 2.5", "steps.count", "a number 2.5", "an integer from 1 to 1000000"),
        ("min_step = 1e-4", "min_step = 0", "steps.min_step", "an integer 0", "a number > 0"),
        ("min_step = 1e-4", "min_step = 1", "steps.min_step", "1.0, longer than a step",
         "at most end / count = 0.4"),
        ("fields = true", 'fields = "vtu"', "output.fields", "a string 'vtu'", "true | false"),
        ("count = 5", f"count = {10**12}", "steps.count", "an integer 1000000000000", "to 1000000"),
        ("min_step = 1e-4", "min_step = 1e-13", "steps.min_step", "1e-13", "at least 1e-12 end = 2e-12"),
        ("checkpoint = true", "checkpoint = 1", "output.checkpoint", "an integer 1", "true | false"),
        ('["ball_top", "tip"]', '"tip"', "output.probes", "a string 'tip'", "a list of names"),
        ('["ball_top", "tip"]', "[1]", "output.probes", "entry 0 is an integer 1", "a list of names"),
    ]
    # fmt: on
    return [pytest.param(*case, id=f"{case[2]}={case[3]}"[:60]) for case in cases]


LEVEL_SET = PLAIN.replace(
    'target = "block_top"', 'name = "hill"\nobstacle = { shape = "level_set", function = "%s" }'
)
