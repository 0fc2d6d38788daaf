"""Contents of ``report.json``: the JSON Schema of its version, from which its page in the docs follows.

Units stand in brackets at the end of a description: [length], [force], [stress] ... are those of the scene, [-] is a
number without one. Vectors have a number per direction of space, see the key ``forces`` for those of forces.
"""

from functools import partial

from pcontact.io.report import FORMAT

_NUMBER, _COUNT, _TEXT = {"type": ["number", "null"]}, {"type": "integer"}, {"type": "string"}
_TRUTH = {"type": "boolean"}
_VECTOR = {"type": "array", "items": {"type": ["number", "null"]}}


def _one(kind, words):
    return {**kind, "description": words}


# a number, null where it is not finite; a whole number; a text; a list of numbers, one per direction where nothing
# else is said
number, count, text, vector = (partial(_one, kind) for kind in (_NUMBER, _COUNT, _TEXT, _VECTOR))


def turned(words):
    """A number in the plane, three in space."""
    return {"description": words, "anyOf": [_NUMBER, _VECTOR]}


def listed(kind, words):
    """A list."""
    return {"type": "array", "items": kind, "description": words}


def table(words, needed=(), **keys):
    """An object with keys that are known."""
    return {"type": "object", "description": words, "properties": keys, "required": list(needed)}


def by_name(kind, words):
    """An object whose keys are names: of contacts, groups, bodies, ..."""
    return {"type": "object", "description": words, "additionalProperties": kind}


_PROBE = {part: vector(f"{words} [length]") for part, words in
          (("mean", "mean over its area or volume, over its nodes where it has none"), ("min", "least"),
           ("max", "largest"))}  # fmt: skip
_CONTACT = table(
    "of one contact",
    ("force", "area", "max_pressure", "max_penetration", "deepest", "open", "stick", "slip", "flipped", "passed",
     "left"),
    force=vector("on the target; of self contact sums of magnitudes [force]"),
    radial_sum=number("axial symmetry: `force[0]`, radial forces summed over the circumference, no resultant [force]"),
    axial_force=number("axial symmetry: `force[1]` [force]"),
    normal_force=vector("part of `force` along the normals; not of self contact [force]"),
    friction_force=vector("part of `force` across them; not of self contact [force]"),
    centre=vector("of the normal force, in the deformed bodies; null without contact [length]"),
    moment=turned("on the target about the origin, on an obstacle that turns, or is a mesh, about its pivot; not with "
                  "axial symmetry and self contact [force * length]"),
    area=number("of the closed points [area]"),
    max_pressure=number("largest contact pressure of the quadrature points [stress]"),
    max_penetration=number("largest penetration of a closed point [length]"),
    deepest=vector("where that is, in the undeformed bodies [length]"),
    least_gap={"type": ["number", "null"], "description": "least gap, negative: overlap; null: no point has a partner "
               "[length]"},
    open=count("quadrature points that are open [-]"),
    stick=count("that stick; without friction none [-]"),
    slip=count("that slip; without friction all that are closed [-]"),
    facets=count("facets of the source that have closed points [-]"),
    max_slip=number("with `slip = true`: largest slip of the load step at points that slide [length]"),
    max_slip_total=number("and of the run so far [length]"),
    max_wear_per_coefficient=number("largest integral of the pressure over the slip so far [stress * length]"),
    wear_volume_per_coefficient=number("that over the area [force * length]"),
    source={"type": "string", "description": "of `surfaces` the one that is the source"},
    target_penetration=number("depth of the deepest node of the target in the source [length]"),
    flipped=count("that changed between these in the last iteration of Newton's method [-]"),
    passed=count("that are inside their partner and were open when partners were found [-]"),
    left=count("that were closed and have left their partner [-]"),
    facet_error=number("part by which straight facets put the pressure wrong, about [-]"),
    unresolved=number("part of the contact pressure that the stress of the cells does not have [-]"),
    bodies=listed(
        table("", ("number", "body", "force"), number=count("of the body, from 0 [-]"), body=text("its region"),
              force=vector("of all others on it [force]")),
        "of contact of all surfaces: each body that others touch",
    ),
)  # fmt: skip
_STRAIN = table(
    "of one body", (), error=number("about how wrong small strain puts its results, as a part of them [-]"),
    strain=number("mean strain [-]"), rotation=number("mean rotation [degrees]"),
    stiffening=number("relative change of forces by what rotations make of lengths, which is left out [-]"),
    place=vector("where most of it is, in the undeformed body [length]"),
)  # fmt: skip
_FINITE = table(
    "of one body", (), largest_stretch=number("largest principal stretch of its cells [-]"),
    smallest_stretch=number("smallest one [-]"), rotation=number("largest rotation of its cells [degrees]"),
    place=vector("middle of the cell whose stretch is farthest from 1, in the undeformed body [length]"),
)  # fmt: skip
_LARGEST = {
    name: table("", (), value=number(f"{words} [{unit}]"), body=text("its region"),
                place=vector("where, in the undeformed body [length]"))
    for name, words, unit in (
        ("displacement", "largest magnitude of nodes", "length"),
        ("equivalent_stress", "largest von Mises' stress, of the means of cells", "stress"),
        ("equivalent_plastic_strain", "where a body may yield: largest mean of cells", "-"),
    )
}  # fmt: skip
_ENERGY = table(
    "with `energy = true`: works so far, and what became of them", ("stored", "defect"),
    **{name: number(f"{words} [force * length]") for name, words in (
        ("loads", "work of the loads"), ("supports", "of the supports"), ("obstacles", "of the obstacles"),
        ("bodies", "of the stresses"), ("springs", "taken up by springs to the ground"),
        ("viscous", "taken up by the viscous stabilisation"), ("snaps", "set free by snaps, with `through_snaps`"),
        ("heat", "supplied by temperatures"),
        ("stored", "elastic energy"), ("plastic", "dissipated by plastic flow"),
        ("initial", "with `[dynamics]`: energy at the beginning"), ("kinetic", "energy of motion"),
        ("gone", "where bodies come and go: what those held that have gone"),
        ("damping", "taken up by damping"), ("numerical", "dissipated by the integrator"),
    )},
    contacts=by_name(number("lost in the contact [force * length]"), "by contact"),
    defect=number("what is missing in the balance, over the largest part of it [-]"),
)  # fmt: skip
_ESTIMATE = table(
    "with `estimate = true`: error of the displacement in the energy norm", ("absolute", "relative", "energy_norm"),
    absolute=number("estimate [sqrt(energy)]"), relative=number("over the largest energy norm of the run [-]"),
    energy_norm=number("of the displacement [sqrt(energy)]"),
    algebraic=number("energy norm of the next Newton step, about [sqrt(energy)]"),
    parts=by_name(number("[sqrt(energy)]"), "by what brings it about"),
    surfaces=by_name(by_name(number("[sqrt(energy)]"), ""), "by contact"),
)  # fmt: skip
_MOTION = {
    "displacement": vector("mean displacement [length]"),
    "rotation": turned("mean rotation [radian]"),
    "force": vector("[force]"),
    "moment": turned("[force * length]"),
}
STEP = table(
    "a load step", ("time", "newton", "krylov", "cutbacks", "reactions", "contacts", "probes", "plastic", "imbalance"),
    time=number("at which it ends [time]"),
    phase=text("name of the phase, in a run with phases"),
    absent=listed(_TEXT, "bodies that are not there in this phase, in a run in which some come or go"),
    newton=count("iterations of Newton's method [-]"),
    krylov=count("of the linear solvers, all together [-]"),
    krylov_most=count("of the linear solve that took most [-]"),
    cutbacks=count("attempts before that did not converge [-]"),
    reactions=by_name(vector("of the support on the bodies [force]"), "by the group of the support"),
    radial_sums=by_name(number("`reactions[...][0]` [force]"),
                        "axial symmetry: radial forces of the supports, summed over the circumference"),
    moments=by_name(turned("[force * length]"), "of supports that turn"),
    contacts=by_name(_CONTACT, "by name"),
    probes=by_name(table("displacement of a group", ("mean", "min", "max"), **_PROBE), "by group"),
    plastic=table("of all bodies", ("max_equivalent_strain", "yielded_volume"),
                  max_equivalent_strain=number("largest equivalent plastic strain [-]"),
                  yielded_volume=number("volume that has yielded [volume]")),
    largest=table("largest values, where they are", (), **_LARGEST),
    small_strain=by_name(_STRAIN, "bodies with small strain: how far they are from what it represents"),
    finite_strain=by_name(_FINITE, "bodies with finite strain: how far they go"),
    viscous=table("with a viscous stabilisation", (), work=number("that it has taken up so far [force * length]"),
                  ratio=number("that over the work of the stresses [-]")),
    snaps=table("with `through_snaps`", (), energy=number("that snaps have set free so far [force * length]")),
    energy=_ENERGY,
    inertia=table("with `[dynamics]`", (), momentum=vector("[mass * length / time]"),
                  moment_of_momentum=turned("about the origin [mass * length^2 / time]")),
    estimate=_ESTIMATE,
    loads=by_name(table("", (), **_MOTION), "total forces and moments, and the mean motion of what they act on"),
    springs=by_name(table("", (), force=vector("on the bodies [force]")), "springs to the ground"),
    couplings=by_name(table("", (), **_MOTION), "groups that move with a point: its motion, and what holds them"),
    pretensions=by_name(table("", (), force=number("tension [force]"), shortening=number("of the bolt [length]")),
                        "bolts"),
    equations=table("linear equations together", (), force=vector("resultant [force]")),
    released=table("of the forces that have ended with an earlier phase", (), force=vector("what is left [force]")),
    uzawa=table("updates of multipliers", (), updates=count("[-]"), change=number("relative, of the last one [-]")),
    partners=table("of contact points, verified at the end of the load step", ("searches",),
                   searches=count("that have verified them; 0: they have not been [-]"),
                   change=number("part of the contact forces by which the last search would have changed them [-]"),
                   unsettled=listed(_TEXT, "contacts where that is more than `-contact_partner_rtol`")),
    free=listed(_TEXT, "loose bodies on which no contact acts"),
    free_bodies=count("how many [-]"),
    imbalance=number("sum of all forces over the largest sum of their magnitudes in the run [-]"),
)  # fmt: skip
_SECONDS = {
    name: number(f"{words} [s]") for name, words in (
        ("total", "of the run"), ("setup", "until the first load step"), ("search", "searches for partners"),
        ("assembly", "residuals and tangents"), ("linear", "linear solves"), ("solve", "load steps without searches"),
        ("output", "fields"), ("compile", "compiling kernels, a part of all the others; 0 where they were kept"),
    )
}  # fmt: skip
_ACCURACY = table(
    "preset of accuracy, and of a run that reaches an error what it found; see accuracy.md", (),
    preset={"type": ["string", "null"], "description": "its name"},
    chosen={"type": "object", "description": "options that it chose"},
    overridden={"type": "object", "description": "options of yours instead"},
    target={"type": "object", "description": "`error` that was asked for, and `of` what"},
    reached=_one(_TRUTH, "whether the error was reached"),
    error=number("the error that is named, as a part [-]"),
    expected=number("the error that is expected, as a part [-]"),
    estimate=number("estimate of the mesh, as a part [-]"),
    parts=by_name(number("[-]"), "the error by what brings it about"),
    effectivity={"type": "object", "description": "the estimate over the error in cases with known answers"},
    quantity={"type": "object", "description": "value, error, extrapolated value and its uncertainty"},
    rate=number("power of the unknowns with which the error falls [-]"),
    half={"type": ["object", "null"], "description": "what half of the error would take"},
    target_cost={"type": ["object", "null"], "description": "what the error that was asked for would take"},
    degree={"type": "object", "description": "degree of the displacement that was chosen, and why"},
    cells={"type": "object", "description": "`chosen`: quadrilaterals, hexahedra that are halved or the simplices that "
           "they were divided into, and `why`"},
    best=count("number of the pass whose results these are, from 1 [-]"),
    passes=listed({"type": "object"}, "meshes: unknowns, error, seconds, ..."),
)  # fmt: skip
REPORT = table(
    "report.json of pcontact", ("format", "title", "version", "ranks", "dofs", "cells", "converged", "model", "steps"),
    format={"const": FORMAT, "description": "version of this layout: one more where a key changes its meaning or goes"},
    title=text("of the scene"),
    version=text("of pcontact"),
    mesh=text("file of the mesh"),
    ranks=count("of MPI [-]"),
    dofs=count("unknowns [-]"),
    cells=count("[-]"),
    converged=_one(_TRUTH, "whether all load steps converged, to the end of the run"),
    model=table("in words", ("active", "left_out"), active=listed(_TEXT, "what is modelled"),
                left_out=listed(_TEXT, "what is not")),
    forces=table("what forces and their components are", ("per", "components"),
                 per={"enum": ["body", "unit thickness", "whole circumference"], "description": "of what they are"},
                 components=listed(_TEXT, "names of the components of all forces, in order")),
    status=listed(_TEXT, "names of the values 0, 1, 2 of the field `status`"),
    accuracy=_ACCURACY,
    solver={"type": "object", "description": "what solves the linear systems"},
    estimate={"type": "object", "description": "`label`: what the estimate is; the numbers of the last load step"},
    warnings=listed(_TEXT, "what the run warned of"),
    steps=listed(STEP, "load steps"),
    timing=table("seconds of the slowest rank", (), **_SECONDS, phases=by_name(number("[s]"), "without those inside"),
                 kernels_mb=number("by how much the largest rank grew as it loaded or compiled kernels [MB]"),
                 peak_memory_mb=number("of all ranks [MB]")),
    parallel={"type": "object", "description": "searches, messages, imbalance of the ranks"},
    memory={"type": "object", "description": "peak and resident set after each phase"},
    counters={"type": "object", "description": "bytes held by array, calls of kernels"},
)  # fmt: skip


def report_schema():
    """JSON Schema (2020-12) of ``report.json``. New keys may come without a new ``format``, so others are admitted.

    Returns
    -------
    dict
    """
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "report.json of pcontact", **REPORT}


def unknown(data, schema=REPORT, path=""):
    """Keys of a report that its schema does not know, and those that it lacks.

    Parameters
    ----------
    data : object
        In types of JSON.

    Returns
    -------
    list of str
    """
    found = []
    if isinstance(data, dict) and "properties" in schema:
        found += [f"{path}{name} is missing" for name in schema["required"] if name not in data]
        for name, one in data.items():
            known = schema["properties"].get(name)
            found += [f"{path}{name}"] if known is None else unknown(one, known, f"{path}{name}.")
    elif isinstance(data, dict) and isinstance(schema.get("additionalProperties"), dict):
        for name, one in data.items():
            found += unknown(one, schema["additionalProperties"], f"{path}{name}.")
    elif isinstance(data, list) and isinstance(schema.get("items"), dict):
        for one in data:
            found += unknown(one, schema["items"], f"{path}[].")
    return found


def described(schema=REPORT, path=""):
    """All keys with what they hold, from the top.

    Yields
    ------
    (str, str)
        ``steps[].contacts.NAME.force``, and its description.
    """
    for name, one in schema["properties"].items():
        yield from _described(one, f"{path}{name}")


def _described(one, path):
    if one.get("description"):
        yield path, one["description"]
    if "properties" in one:
        yield from described(one, f"{path}.")
    if isinstance(one.get("additionalProperties"), dict):
        yield from _described(one["additionalProperties"], f"{path}.NAME")
    if isinstance(one.get("items"), dict):
        yield from _described(one["items"], f"{path}[]")
