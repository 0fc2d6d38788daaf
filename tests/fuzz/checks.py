"""What must hold in every run by itself, from its scene, its displacements and its report.

* Forces balance: of all bodies together, and of each body, with loads that are integrated anew here.
* The force of a contact is the sum over its points; open points bear nothing.
* Nodes of both surfaces of a contact are not inside the partner by more than a part of a facet, or a warning is there.
* A contact whose surfaces are apart has no force.
* With inertia the momentum of all bodies changes by the impulse of the outer forces, by the rule of the integrator, and
  elastic bodies of small strain have a balance of energy up to rounding errors.
* Where the first load step takes no iteration of Newton's method, nothing acts and nothing has moved but bodies all of
  whose nodes are prescribed. Later ones may end where the motion of the last one leads.
"""

from itertools import pairwise

import numpy as np
from formulas import Formula
from grids import DIM, FACETS, MIDDLES, VERTICES, facet_nodes, reference

# [-] part of the largest force of the run that may be out of balance with the tolerance of TIGHT, and with that of the
# program, 1e-8 of the first residual
BALANCE, LOOSE = 1e-7, 1e-3
# [-] the same of loads that are expressions, which the program integrates with few points
EXPRESSIONS = 1e-3
# [-] part of the smallest facet near by that a node may be inside the partner without a warning
INSIDE = 0.15
# [-] part of the same by which surfaces have to be apart to be so without doubt, whatever curves between nodes
APART = 0.1
# of a reference cell by which a point on the border of two cells is in both
EDGE = 1e-9
# words of warnings that say that partners were wrong
SAID = ("smaller load steps", "inside", "enter each other", "search_radius", "search radius", "overlap",
        "multipliers")  # fmt: skip


# -- amplitudes and phases ---------------------------------------------------------------------------------


def phases_of(scene):
    """(name, begin, end) of every phase; one without a name where there are none."""
    if "phases" not in scene:
        return [(None, 0.0, scene["steps"]["end"])]
    ends = np.cumsum([0.0, *(p["duration"] for p in scene["phases"])])
    return [(p["name"], a, b) for p, (a, b) in zip(scene["phases"], pairwise(ends), strict=True)]


def acts(table, phase):
    """Whether a table of the scene acts in a phase."""
    return phase is None or phase in table.get("phases", [phase])


def formulas_in(value):
    """The formulas in a value or a list of them."""
    return [one for one in (value if isinstance(value, list) else [value]) if isinstance(one, Formula)]


def factor(scene, table, value, t):
    """Factor of a value at a time: its amplitude, 1 where the value has the time, or a ramp."""
    if "amplitude" in table:
        return float(np.interp(t, *np.array(table["amplitude"]).T))
    texts = [text for one in formulas_in(value) for _, text in one.terms]
    if any("t" in text.replace("sqrt", "").replace("tanh", "") for text in texts):
        return 1.0
    first = next(p for p in phases_of(scene) if acts(table, p[0]))
    return float(np.clip((t - first[1]) / (first[2] - first[1]), 0.0, 1.0))


# -- geometry ------------------------------------------------------------------------------------------------


def _shapes(cell, degree, xi):
    """Shape functions (n, nodes) and slopes (n, nodes, d) at places xi (n, d) of a reference cell."""
    nodes, d = reference(cell, degree), DIM[cell]
    if cell in ("triangle", "tetrahedron"):
        powers = [p for p in np.ndindex(*[degree + 1] * d) if sum(p) <= degree]
    else:
        powers = list(np.ndindex(*[degree + 1] * d))

    def table(x, slope=None):
        columns = []
        for power in powers:
            column = np.ones(len(x))
            for k, n in enumerate(power):
                if k == slope:
                    column = column * (n * x[:, k] ** max(n - 1, 0))
                else:
                    column = column * x[:, k] ** n
            columns.append(column)
        return np.array(columns).T

    coefficients = np.linalg.inv(table(nodes))
    slopes = np.stack([table(xi, k) @ coefficients for k in range(d)], axis=2)
    return table(xi) @ coefficients, slopes


def _rule(cell):
    """Places and weights that are exact enough for expressions, on a reference cell."""
    s, w = np.polynomial.legendre.leggauss(6)
    s, w, d = 0.5 * (s + 1.0), 0.5 * w, DIM[cell]
    xi = np.stack(np.meshgrid(*[s] * d, indexing="ij"), axis=-1).reshape(-1, d)
    weights = np.prod(np.stack(np.meshgrid(*[w] * d, indexing="ij"), axis=-1).reshape(-1, d), axis=1)
    if cell in ("triangle", "tetrahedron"):
        # the cube folded onto the simplex
        rest = np.ones(len(xi))
        for k in range(d):
            xi[:, k] *= rest
            weights = weights * rest ** (1 if k else 0)
            rest = rest - xi[:, k]
    return xi, weights


def integration_points(groups, points, axial):
    """Places (n, d) and areas or volumes (n,) of the integration points of elements; of rings with axial symmetry, and
    the area vectors of facets."""
    places, sizes, normals = [], [], []
    for e in groups:
        xi, w = _rule(e.cell)
        shapes, slopes = _shapes(e.cell, e.degree, xi)
        x = np.einsum("qn,end->eqd", shapes, points[e.nodes])
        J = np.einsum("qnk,end->eqdk", slopes, points[e.nodes])
        if J.shape[2] == J.shape[3]:
            size, vector = np.abs(np.linalg.det(J)), np.zeros_like(x)
        elif J.shape[2] == 2:
            vector = np.stack([J[:, :, 1, 0], -J[:, :, 0, 0]], axis=2)
            size = np.linalg.norm(vector, axis=2)
        else:
            vector = np.cross(J[..., 0], J[..., 1])
            size = np.linalg.norm(vector, axis=2)
        around = 2.0 * np.pi * x[:, :, :1] if axial else 1.0
        size, vector = size * np.squeeze(around, -1) * w if axial else size * w, vector * around * w[None, :, None]
        places.append(x.reshape(-1, x.shape[2]))
        sizes.append(size.ravel())
        normals.append(vector.reshape(-1, x.shape[2]))
    return np.concatenate(places), np.concatenate(sizes), np.concatenate(normals)


def _straight(groups, points):
    """Facets as straight pieces: corners (n, d, d), segments or triangles; degree 2 in several."""
    pieces = []
    for e in groups:
        rows = {
            ("segment", 1): [(0, 1)], ("segment", 2): [(0, 2), (2, 1)],
            ("triangle", 1): [(0, 1, 2)], ("triangle", 2): [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)],
            ("quadrilateral", 1): [(0, 1, 2), (0, 2, 3)],
            ("quadrilateral", 2): [(0, 4, 8), (0, 8, 7), (4, 1, 5), (4, 5, 8),
                                   (8, 5, 2), (8, 2, 6), (7, 8, 6), (7, 6, 3)],
        }[e.cell, e.degree]  # fmt: skip
        for row in rows:
            pieces.append(points[e.nodes[:, list(row)]])
    return np.concatenate(pieces)


def fine(groups, points):
    """Facets as straight pieces, those of degree 2 in more of them than `_straight` has: they follow the curve."""
    pieces = []
    for e in groups:
        x, d = points[e.nodes], DIM[e.cell]
        corners = np.array(VERTICES[e.cell], dtype=float)
        rows = [corners] if e.cell != "quadrilateral" else [corners[[0, 1, 2]], corners[[0, 2, 3]]]
        for _ in range(2 * e.degree - 2 if e.cell != "segment" else 3 * e.degree - 3):
            rows = [one for row in rows for one in _halves(row)]
        shapes = np.array([_shapes(e.cell, e.degree, row)[0] for row in rows])
        pieces.append(np.einsum("qka,nad->nqkd", shapes, x).reshape(-1, d + 1, points.shape[1]))
    return np.concatenate(pieces)


def _halves(corners):
    """Segments and triangles of half the size."""
    middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
    if len(corners) == 2:
        return [np.array([corners[0], middles[0]]), np.array([middles[0], corners[1]])]
    (a, b, c), (p, q, r) = corners, middles
    return [np.array(row) for row in ((a, p, r), (p, b, q), (r, q, c), (p, q, r))]


def _samples(pieces, count=4):
    """Points (n, d) on straight pieces, their corners and edges among them."""
    n = pieces.shape[1]
    rows = [row for row in np.ndindex(*[count + 1] * (n - 1)) if sum(row) <= count]
    weights = np.array([[*row, count - sum(row)] for row in rows]) / count
    return np.einsum("qk,mkd->mqd", weights, pieces).reshape(-1, pieces.shape[2])


def distances(x, pieces):
    """Distances (n,) of points (n, d) from straight pieces (m, d, d)."""
    a, best = pieces[:, 0], np.full(len(x), np.inf)

    def to_segment(p, q):
        along = q - p
        s = np.einsum("nmd,md->nm", x[:, None] - p, along) / np.maximum(np.sum(along**2, axis=1), 1e-300)
        near = p + np.clip(s, 0.0, 1.0)[:, :, None] * along
        return np.linalg.norm(x[:, None] - near, axis=2).min(axis=1)

    count = pieces.shape[1]
    for k in range(count if count > 2 else 1):
        best = np.minimum(best, to_segment(pieces[:, k], pieces[:, (k + 1) % count]))
    if count == 3:
        u, v = pieces[:, 1] - a, pieces[:, 2] - a
        n = np.cross(u, v)
        n2 = np.maximum(np.sum(n**2, axis=1), 1e-300)
        w = x[:, None] - a
        beta = np.einsum("nmd,md->nm", np.cross(u[None], w), n) / n2
        alpha = np.einsum("nmd,md->nm", np.cross(w, v[None]), n) / n2
        over = (alpha >= 0.0) & (beta >= 0.0) & (alpha + beta <= 1.0)
        height = np.abs(np.einsum("nmd,md->nm", w, n)) / np.sqrt(n2)
        best = np.minimum(best, np.where(over, height, np.inf).min(axis=1))
    return best


def size_near(x, pieces):
    """Shortest edge (n,) of the straight pieces (m, d, d) that are nearest to points (n, d)."""
    size = np.linalg.norm(np.roll(pieces, 1, axis=1) - pieces, axis=2).min(axis=1)
    apart = np.array([distances(x, piece[None]) for piece in pieces])
    return np.where(apart <= apart.min(axis=0) + EDGE * size.min(), size[:, None], np.inf).min(axis=0)


def within(x, groups, points):
    """Whether points (n, d) are inside cells."""
    found = np.zeros(len(x), dtype=bool)
    for e in groups:
        corners = points[e.nodes]
        low, high = corners.min(axis=1), corners.max(axis=1)
        for k in range(len(e.nodes)):
            near = np.flatnonzero(~found & ((x >= low[k]) & (x <= high[k])).all(axis=1))
            if len(near):
                found[near] = _in_cell(e, corners[k], x[near])
    return found


def _in_cell(e, corners, x):
    """Newton's method for the place in a cell."""
    xi = np.full(x.shape, 1.0 / 3.0)
    for _ in range(12):
        shapes, slopes = _shapes(e.cell, e.degree, xi)
        J = np.einsum("qnk,nd->qdk", slopes, corners)
        good = np.abs(np.linalg.det(J)) > 0.0
        step = np.zeros_like(xi)
        step[good] = np.linalg.solve(J[good], (x - shapes @ corners)[good][:, :, None])[:, :, 0]
        xi = xi + np.clip(step, -0.5, 0.5)
    shapes, _ = _shapes(e.cell, e.degree, xi)
    exact = np.linalg.norm(shapes @ corners - x, axis=1) < 1e-6 * np.ptp(corners)
    inside = (xi > -EDGE).all(axis=1) & (xi < 1.0 + EDGE).all(axis=1)
    if e.cell in ("triangle", "tetrahedron"):
        inside &= xi.sum(axis=1) < 1.0 + EDGE
    return exact & inside


def boundary(mesh, body):
    """Facets of a body that belong to one of its cells alone."""
    from_cells, count = {}, {}
    for e in mesh.bodies[body]:
        kind, rows = facet_nodes(e.cell, e.degree)
        for row in rows:
            for nodes in e.nodes[:, row]:
                key = frozenset(nodes[: len(VERTICES[FACETS[e.cell][0]])].tolist())
                count[key] = count.get(key, 0) + 1
                from_cells[key] = (kind, e.degree, nodes)
    groups = {}
    for key, (kind, degree, nodes) in from_cells.items():
        if count[key] == 1:
            groups.setdefault((kind, degree), []).append(nodes)
    return [type(mesh.bodies[body][0])(kind, degree, np.array(nodes)) for (kind, degree), nodes in groups.items()]


def places(mesh, row):
    """Points of the mesh in a load step; those that carry no displacement of their own lie between their vertices."""
    u = np.zeros((max(len(mesh.points), row["nodes"].max() + 1), mesh.dim))
    known = np.zeros(len(u), dtype=bool)
    u[row["nodes"]], known[row["nodes"]] = row["u"], True
    for e in (e for groups in mesh.bodies.values() for e in groups if e.degree == 2):
        first = len(VERTICES[e.cell])
        for k, group in enumerate(MIDDLES[e.cell]):
            nodes = e.nodes[:, first + k]
            between = u[e.nodes[:, list(group)]].mean(axis=1)
            u[nodes[~known[nodes]]] = between[~known[nodes]]
    return mesh.points + u[: len(mesh.points)]


def raised(mesh, row):
    """The mesh with nodes wherever the displacement has some, as surfaces bulge between those of the file, and the
    places of its points in a load step: first those of the file."""
    new, x, first = mesh.copy(np.vstack([mesh.points, row["x"]])), places(mesh, row), len(mesh.points)
    for e in (e for groups in (new.bodies, new.facets) for some in groups.values() for e in some if e.degree == 1):
        for group in MIDDLES[e.cell]:
            middle = mesh.points[e.nodes[:, list(group)]].mean(axis=1)
            apart = np.linalg.norm(middle[:, None] - row["x"], axis=2)
            if apart.min(axis=1).max(initial=0.0) > EDGE * np.ptp(mesh.points):
                return mesh, x
            e.nodes = np.column_stack([e.nodes, first + apart.argmin(axis=1)])
        e.degree = 2
    return new, np.vstack([x, row["x"] + row["u"]])


def body_of(mesh, group):
    """The body that a group is on."""
    return next(b for b in sorted(mesh.bodies, key=len, reverse=True) if group == b or group.startswith(f"{b}_"))


# -- forces --------------------------------------------------------------------------------------------------


def applied(case, table, t):
    """Resultant (d,) of a dead load of the scene at a time; None of one that follows or turns."""
    scene = case.scene
    if table.get("follower") or "angular_speed" in table:
        return None
    key = next(k for k in ("pressure", "traction", "body_force", "acceleration", "force") if k in table)
    value = table[key]
    scale = factor(scene, table, value, t)
    if key == "force":
        return scale * np.array(value)
    groups = case.mesh.facets.get(table["region"]) or case.mesh.bodies[table["region"]]
    x, size, normal = integration_points(groups, case.mesh.points, case.axial)

    def at(one):
        return one(x, t) if isinstance(one, Formula) else np.full(len(x), one)

    if key == "pressure":
        # the area vector of the facets may look to either side: outwards is away from the body
        inner = np.concatenate([e.nodes for e in case.mesh.bodies[body_of(case.mesh, table["region"])]], axis=None)
        out = np.sign(np.sum(normal.sum(axis=0) * (x.mean(axis=0) - case.mesh.points[inner].mean(axis=0))))
        signed = np.abs(np.sum(normal * (out * normal.sum(axis=0)), axis=1)) > 0.0
        aligned = np.sign(np.sum(normal * normal.sum(axis=0), axis=1))[:, None] * normal * out
        return -scale * (at(value)[signed, None] * aligned[signed]).sum(axis=0)
    if key == "acceleration":
        body = next(b for b in scene["bodies"] if b["region"] == table["region"])
        scale *= scene["materials"][body["material"]]["density"]
    return scale * np.array([(at(one) * size).sum() for one in value])


def _forces(case, row, loads):
    """Forces on every body, and the outer ones on all of them; without those of contacts of all surfaces."""
    mesh, record = case.mesh, row["record"]
    bodies = {name: [] for name in mesh.bodies}
    for region, force in record["reactions"].items():
        bodies[body_of(mesh, region)].append(np.array(force))
    for kind, tables in (("springs", case.scene.get("springs", [])), ("couplings", case.scene.get("couplings", []))):
        for table in tables:
            if table["name"] in record.get(kind, {}):
                force = np.array(record[kind][table["name"]]["force"])
                bodies[body_of(mesh, table["region"])].append(force)
    for region, force in loads:
        bodies[body_of(mesh, region)].append(force)
    outer = [force for forces in bodies.values() for force in forces]
    for contact in case.scene.get("contacts", []):
        name = contact.get("name") or "all"
        if name not in record["contacts"]:
            continue
        found = record["contacts"][name]
        force = np.array(found["force"])
        if "obstacle" in contact:
            outer.append(-force)
            if "source" in contact:
                bodies[body_of(mesh, contact["source"])].append(-force)
            else:
                bodies = dict.fromkeys(bodies)
                break
        elif contact.get("all"):
            for one in found["bodies"]:
                bodies[one["body"]].append(np.array(one["force"]))
        elif contact["source"] != contact["target"]:
            bodies[body_of(mesh, contact["target"])].append(force)
            bodies[body_of(mesh, contact["source"])].append(-force)
    return bodies, outer


def balance(case, result, tight):
    """Findings about forces: (kind, text)."""
    found, largest, scene = [], 0.0, case.scene
    least = 1e-6 * case.stress * case.length ** (2 if case.axial or case.dim == 3 else 1)
    if "viscous_stabilisation" in scene["steps"]:
        return []
    said = any(formulas_in(value) for one in scene.get("loads", []) for value in one.values())
    allowed = max(BALANCE if tight else LOOSE, EXPRESSIONS * said)
    warned = any("out of balance" in line for line in result["warnings"])
    worst = 0.0
    for row in result["steps"]:
        record, t = row["record"], row["record"]["time"]
        tables = [one for one in scene.get("loads", []) if acts(one, record.get("phase"))]
        tables = [one for one in tables if body_of(case.mesh, one["region"]) not in record.get("absent", [])]
        known = [applied(case, one, t) for one in tables]
        complete = all(one is not None for one in known)
        loads = [(one["region"], force) for one, force in zip(tables, known, strict=True) if force is not None]
        bodies, outer = _forces(case, row, loads)
        largest = max([largest, least, *(np.linalg.norm(f) for forces in bodies.values() for f in forces or [])])
        released = np.array(record.get("released", {"force": np.zeros(case.dim)})["force"])
        first = 1 if case.axial else 0
        springs = sum((np.array(s["force"]) for s in record.get("springs", {}).values()), np.zeros(case.dim))
        rows = []
        if complete and "inertia" in record:
            rows.append(("loads", row["applied"] - springs - released - sum((f for _, f in loads), np.zeros(case.dim))))
        elif complete:
            rows.append(("loads", row["applied"] - springs - released - sum((f for _, f in loads), np.zeros(case.dim))))
            rows.append(("all bodies", sum(outer, released)))
            ended = not np.any(np.abs(released) > 1e-9 * largest) and "phase" not in record
            rows += [(f"body {name}", sum(forces, np.zeros(case.dim))) for name, forces in bodies.items()
                     if forces and (ended or row is _last_of(result, record))]  # fmt: skip
        for what, rest in rows:
            size = np.linalg.norm(rest[first:])
            if what == "all bodies":
                worst = max(worst, size / largest)
            if size > allowed * largest + 8.0 * row["floor"]:
                found.append(("unbalanced", f"time {t:g}: {what} by {size / largest:.1e} of the largest force"))
    if warned and worst < 1e-4:
        found.append(("false warning", f"out of balance is said, but it is {worst:.1e}"))
    return found


def _last_of(result, record):
    """The last load step of a phase, at whose end nothing of what has ended is left."""
    return [row for row in result["steps"] if row["record"].get("phase") == record.get("phase")][-1]


# -- inertia -------------------------------------------------------------------------------------------------

# [-] part of the energy that may be missing where bodies are elastic and of small strain
MISSING = 1e-7


def _weights(table):
    """f, m, (d0, d1), (s0, s1) of an integrator of the scene: (1 - m) M a1 + m M a0 = (1 - f) q1 + f q0."""
    name, alpha = table["integrator"], table.get("alpha", -0.1)
    if name == "euler":
        return 0.0, 0.0, (0.0, 1.0)
    alpha = 0.0 if name == "trapezoidal" else alpha
    return -alpha if name == "hht" else 0.0, alpha if name == "bossak" else 0.0, (0.5 + alpha, 0.5 - alpha)


def motion(case, result, tight):
    """Findings about momentum and energy of runs with inertia: (kind, text)."""
    scene, first = case.scene, 1 if case.axial else 0
    if "dynamics" not in scene or any(formulas_in(v) for one in scene.get("loads", []) for v in one.values()):
        return []
    f, m, (s0, s1) = _weights(scene["dynamics"])
    slow, found, rows = scene["bodies"][0].get("mass_damping", 0.0), [], []
    # a point that has mass is not damped, and momenta are those of bodies and points together
    unknown = slow > 0.0 and any("mass" in one for one in scene.get("couplings", []))
    least = 1e-6 * case.stress * case.length ** (2 if case.axial or case.dim == 3 else 1)
    for row in result["steps"]:
        record = row["record"]
        tables = [one for one in scene.get("loads", []) if acts(one, record.get("phase"))]
        tables = [one for one in tables if body_of(case.mesh, one["region"]) not in record.get("absent", [])]
        known = [applied(case, one, record["time"]) for one in tables]
        if "inertia" not in record or unknown or any(force is None for force in known):
            continue
        outer = _forces(case, row, [(one["region"], force) for one, force in zip(tables, known, strict=True)])[1]
        momentum = np.array(record["inertia"]["momentum"])
        force = sum(outer, np.array(record.get("released", {"force": np.zeros(case.dim)})["force"]))
        force = force - slow * momentum
        rows.append((record, momentum[first:], force[first:], max([least, *map(np.linalg.norm, outer)]), row["floor"]))
    largest, before = max([one[3] for one in rows], default=least), None
    speed = max([np.linalg.norm(one[1]) for one in rows], default=0.0)
    moved = [one for key in ("displacements", "couplings", "pretensions") for one in scene.get(key, [])]
    corners = {time for one in moved for time, _ in one.get("amplitude") or []}
    for one, other in pairwise(rows):
        size = other[0]["time"] - one[0]["time"]
        if one[0]["time"] in corners:
            # supports exert an impulse
            before = None
            continue
        if one[0].get("phase") != other[0].get("phase") or one[0].get("absent") != other[0].get("absent"):
            before = None
            continue
        # M a at both ends; that at the beginning of the second load step is what its end asks for where it is unknown
        if before is None:
            known = (other[1] - one[1]) / size
            given = (1.0 - f) * other[2] + f * one[2]
            before = (known - s1 * given / (1.0 - m)) / (s0 - s1 * m / (1.0 - m)) if s0 or m else one[2]
            before = one[2] if m == 0.0 and f == 0.0 else before
        after = ((1.0 - f) * other[2] + f * one[2] - m * before) / (1.0 - m)
        rest = np.linalg.norm(other[1] - one[1] - size * (s0 * before + s1 * after))
        allowed = (BALANCE if tight else LOOSE) * (size * largest + speed) + 8.0 * size * other[4]
        if rest > allowed:
            found.append(("momentum", f"time {other[0]['time']:g}: {rest:.1e} of the momentum {speed:.1e}, "
                                      f"forces {largest:.1e} in {size:.1e}"))  # fmt: skip
        before = after
    yields = any({"yield_stress", "hardening_curve"} & one.keys() for one in scene["materials"].values())
    exact = not (case.finite or yields or "temperatures" in scene)
    for row in result["steps"]:
        energy = row["record"].get("energy", {"defect": 0.0})
        if exact and abs(energy["defect"]) > (MISSING if tight else LOOSE):
            found.append(("energy", f"time {row['record']['time']:g}: {energy['defect']:.1e} of it is missing"))
    return found


def sums(case, result):
    """Forces of contacts against the sums over their points: (kind, text)."""
    found, least = [], 1e-12 * case.stress * case.length ** (2 if case.axial or case.dim == 3 else 1)
    for row in result["steps"]:
        for name, points in row["points"].items():
            contact, forces = row["record"]["contacts"][name], points["forces"]
            if "bodies" in contact or (len(forces) == 1 and _self(case, name)):
                continue
            total = forces[0] - forces[1] if len(forces) == 2 else forces[0]
            apart = np.linalg.norm(total - contact["force"])
            if apart > 1e-9 * np.linalg.norm(contact["force"]) + least:
                found.append(("sum of points", f"time {row['record']['time']:g}: {name} by {apart:.1e}"))
            if points["open"] > 0.0 and not _glued(case, name):
                text = f"time {row['record']['time']:g}: {name}: a traction of {points['open']:.1e} at an open point"
                found.append(("open points", text))
    return found


def _contact(case, name):
    return next(c for c in case.scene["contacts"] if (c.get("name") or "all") == name)


def _self(case, name):
    contact = _contact(case, name)
    return bool(contact.get("all")) or contact["source"] == contact.get("target")


def _glued(case, name):
    """Tractions that need no pressure."""
    contact = _contact(case, name)
    return any(contact.get(key) for key in ("tied", "bilateral", "tresca", "adhesion")) or any(
        name in phase.get("tied", []) for phase in case.scene.get("phases", [])
    )


# -- penetration ---------------------------------------------------------------------------------------------


def _surfaces(mesh, contact):
    """Pairs of (facets, body) of a contact whose nodes must not be inside each other."""
    if contact.get("all") and "obstacle" not in contact:
        names = list(mesh.bodies)
        return [(boundary(mesh, a), b) for a in names for b in names if a != b]
    if "source" not in contact or "obstacle" in contact or contact["source"] == contact["target"]:
        return []
    one, other = contact["source"], contact["target"]
    return [(mesh.facets[one], body_of(mesh, other)), (mesh.facets[other], body_of(mesh, one))]


def strain(record):
    """Largest strain [-] that the report names: so far apart, in parts of a facet, points press by Nitsche's method
    where the stress of their cell exceeds gamma, at least its modulus over its size, times the gap."""
    finite = [abs(one[key] - 1.0) for one in record.get("finite_strain", {}).values()
              for key in ("largest_stretch", "smallest_stretch")]  # fmt: skip
    return max([*finite, *(one["strain"] for one in record.get("small_strain", {}).values())], default=0.0)


def penetration(case, result):
    """Nodes inside the partner: (kind, text)."""
    found = []
    said = any(word in line for line in result["warnings"] for word in SAID)
    for row in result["steps"]:
        mesh, x = raised(case.mesh, row)
        absent = row["record"].get("absent", [])
        for contact in case.scene.get("contacts", []):
            name = contact.get("name") or "all"
            strange = any(key in contact for key in ("tied", "interference", "pressure_overclosure", "clearance"))
            if strange or name not in row["record"]["contacts"] or "phases" in case.scene:
                # what is there in other phases may overlap as it is
                continue
            force = np.linalg.norm(row["record"]["contacts"][name]["force"])
            apart = np.inf
            for (facets, body), (flat, _) in zip(*(_surfaces(m, contact) for m in (mesh, case.mesh)), strict=True):
                if body in absent:
                    continue
                outer = boundary(mesh, body)
                pieces, own = _straight(boundary(case.mesh, body), x), _straight(flat, x)
                nodes = np.unique(np.concatenate([e.nodes.ravel() for e in facets]))
                nodes = nodes[within(x[nodes], mesh.bodies[body], x)]
                sizes = np.min([size_near(x[nodes], own), size_near(x[nodes], pieces)], axis=0)
                depth, allowed = distances(x[nodes], fine(outer, x)), INSIDE * sizes
                if "dynamics" in case.scene:
                    # what has overlapped at the beginning goes apart in time
                    outside = distances(mesh.points[nodes], fine(outer, mesh.points))
                    outside = outside[within(mesh.points[nodes], mesh.bodies[body], mesh.points)]
                    allowed = allowed + float(np.max(outside, initial=0.0))
                if contact.get("formulation") == "penalty":
                    # an impact goes as deep as the springs are soft, and the report says so, of points between nodes
                    allowed = np.maximum(allowed, 2.0 * row["record"]["contacts"][name]["max_penetration"])
                if np.any(depth > allowed) and not said and not contact.get("bilateral"):
                    k = np.argmax(depth - allowed)
                    where = mesh.points[nodes[k]]
                    found.append(("inside", f"time {row['record']['time']:g}: a node of {name} at {where} is "
                                            f"{depth[k] / sizes[k]:.2f} of a facet inside {body}"))  # fmt: skip
                size = min(np.linalg.norm(p[:, 1] - p[:, 0], axis=1).min() for p in (pieces, own))
                near = 0.0 if len(nodes) else float(distances(_samples(own), pieces).min())
                apart = min(apart, near - (APART + strain(row["record"])) * size)
            least = 1e-9 * case.stress * case.length ** (2 if case.axial or case.dim == 3 else 1)
            if np.isfinite(apart) and apart > 0.0 and force > least and not _glued(case, name):
                found.append(("force without touch", f"time {row['record']['time']:g}: {name} bears {force:.1e} "
                                                     f"at a distance of {apart:.1e}"))  # fmt: skip
    return found


# -- the first load step -----------------------------------------------------------------------------------------


def idle(case, result):
    """A first load step that was accepted without an iteration though something acts or has moved: (kind, text)."""
    mesh, scene, row = case.mesh, case.scene, result["steps"][0]
    words = ("value", "pressure", "traction", "body_force", "acceleration", "force", "displacement")
    record = row["record"]
    if record["newton"]:
        return []
    tools = {one["region"] for one in scene.get("displacements", []) if one["region"] in mesh.bodies}
    for key in ("displacements", "loads", "couplings"):
        for one in scene.get(key, []):
            there = acts(one, record.get("phase")) and one["region"] not in tools
            if not there or body_of(mesh, one["region"]) in record.get("absent", []):
                continue
            value = next((one[k] for k in words if k in one), None)
            moves = [v for v in (value if isinstance(value, list) else [value]) if v not in ("free", 0.0)]
            if moves and factor(scene, one, value, record["time"]):
                return [("no iterations", f"time {record['time']:g}: {key} of {one['region']} act")]
    if any(c["stick"] + c["slip"] for c in record["contacts"].values()):
        return [("no iterations", f"time {record['time']:g}: bodies touch")]
    return []


# -- all of it -------------------------------------------------------------------------------------------------


def check(case, result, tight=True):
    """Findings of a run, the first of every kind: list of (kind, text)."""
    if result["status"] not in ("converged", "stopped") or not result["steps"]:
        return []
    found = [*balance(case, result, tight), *motion(case, result, tight), *sums(case, result),
             *penetration(case, result), *idle(case, result)]
    return list({kind: (kind, text) for kind, text in reversed(found)}.values())[::-1]
