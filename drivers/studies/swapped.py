"""Which surface is the source: errors of the pressure both ways round, over ratios of stiffness and of facets.

    python drivers/studies/swapped.py -o DIR [--ratios 1e-6 1e-3 1 1e3 1e6] [--strains small finite]
        [--publish docs/tables/swapped.md]

Two blocks in full contact, the upper one 0.3 high, bear a pressure that varies and, with friction, stick and slip, in
plane strain; the pressure of the points is compared in L2 with that of meshes of 96 facets on both sides. Concentric
rings, the outer one is called upper, bear a pressure from outside (straight facets of degree 1, curved ones of degree
2, the gap between the circles is said to be 0); the pressure is compared with Lame's. With finite strain blocks bear
ten times the pressure, and rings a tenth, of degree 1 and ratios up to 1e3. Columns say which side is the source, with
the traction of both sides and with that of the source alone, and what the program chooses of `surfaces`; the last one
how far the integrals of the pressure with either source and the traction of both sides are apart. What does not
converge is a dash.

Where both ways round differ most, 1.4 and 0.59 % between rings of straight facets 8:5, the normals of the facets are
why: pressure acts along those of the target, which are off those of the circle by the angles of its facets. With the
normals of the circle the errors are 0.43 and 0.45 %, with equal moduli 1.3 and 1.7 instead of 2.1 and 1.8 %, and with
the mean of both facets' normals 0.62 and 0.48 %, 1.6 and 1.6 %. Such normals are not those along which the gap between
the facets changes where they slide: an elastic clip gains work with weighted ones (docs/formulations.md). Curved
facets hardly have other normals than the circle, and both ways round differ by a tenth at most.
"""

from itertools import product

import numpy as np

from drivers._common import main, make_directory, make_mesh, make_parser, markdown, print_table, running, write_json
from drivers.studies._harness import composed
from meshes import rings, two_blocks
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact, Load, Material, MeshSpec

# facets of the upper and the lower side
FACETS = {"1:1": (12, 12), "2:1": (16, 8), "1:2": (8, 16), "10:1": (60, 6), "1:10": (6, 60)}
FINE = 96
BLOCKS, RINGS = ("upper_bottom", "lower_top"), ("outer_inner_skin", "inner_outer_skin")
WAYS = ("upper", "lower", "surfaces", "both", "upper alone", "lower alone")
HEAD = ["scene", "degree", "E upper/lower", "friction", "facets", *WAYS, "forces apart, %"]
# of the rings [length]
HOLE, CIRCLE, OUTSIDE, POISSON = 0.2, 0.6, 1.0, 0.3
# over the softer modulus; Lame knows no finite strain
RING_LOAD = {"small": 1e-3, "finite": 1e-4}


def contact(names, way, friction, **more):
    """The contact of the upper and the lower surface in one of the ways."""
    upper, lower = names if way.startswith("upper") or way == "both" else names[::-1]
    said = {"surfaces": [upper, lower]} if way == "surfaces" else {"source": upper, "target": lower}
    if "alone" in way:
        said["traction"] = "source"
    return Contact(**said, name="c", friction=friction or None, unbiased=way == "both", **more)


def _radial(modulus, radii, inside, outside):
    """Radial displacement of Lame's ring under pressures on both circles, at the circle of contact [length]."""
    a, b = radii
    first = (inside * a**2 - outside * b**2) / (b**2 - a**2)
    second = (inside - outside) * (a * b) ** 2 / (b**2 - a**2)
    return (1.0 + POISSON) / modulus * ((1.0 - 2.0 * POISSON) * first * CIRCLE + second / CIRCLE)


def ring_pressure(ratio, load):
    """Contact pressure between the rings, the outer one `ratio` times as stiff, under a pressure from outside."""
    def gap(p):
        return _radial(ratio, (CIRCLE, OUTSIDE), p, load) - _radial(1.0, (HOLE, CIRCLE), 0.0, p)

    return -gap(0.0) / (gap(1.0) - gap(0.0))


def ring_scene(path, order, ratio, friction, way, strain="small"):
    """Concentric rings, the outer one `ratio` times as stiff."""
    return composed(
        MeshSpec(path, order=order, strain=strain),
        {"outer": Material(E=ratio, nu=POISSON), "inner": Material(E=1.0, nu=POISSON)},
        {"symmetry_x": [0.0, "free"], "symmetry_y": ["free", 0.0]},
        title="exchanged rings",
        contacts=[contact(RINGS, way, friction, clearance=0.0)],
        loads=[Load("outer_skin", pressure=RING_LOAD[strain] * min(1.0, ratio))],
    )


def scene(path, order, ratio, friction, way, strain="small"):
    """The blocks, the upper one `ratio` times as stiff."""
    unit = (1e-2 if strain == "finite" else 1e-3) * min(1.0, ratio)
    return composed(
        MeshSpec(path, order=order, strain=strain),
        {"lower": Material(E=1.0, nu=0.3), "upper": Material(E=ratio, nu=0.3)},
        {"lower_bottom": [0.0, 0.0], "left": [0.0, "free"], "right": [0.0, "free"]},
        title="exchanged surfaces",
        contacts=[contact(BLOCKS, way, friction)],
        loads=[Load("upper_top", traction=[0.0, f"{-unit}*(1 + 0.5*cos(2*pi*x))"])],
    )


def solved(case):
    """Places, pressures and weights of the points, and Newton iterations; None without an answer."""
    with running(case) as (simulation, converged):
        if not converged:
            return None
        state = simulation.problem.contacts[0].state(simulation.stepper.u)
        return state["x"][:, 0], state["pressure"], state["weight"], len(simulation.newton.norms) - 1


def error(found, known):
    """Of the pressure in L2 over that of the reference, iterations, integral of the pressure; None without them."""
    if found is None or known is None:
        return None
    x, pressure, weight, iterations = found
    order = np.argsort(known[0])
    true = np.interp(x, known[0][order], known[1][order])
    in_l2 = np.sqrt(weight @ (pressure - true) ** 2 / (weight @ true**2))
    return [float(in_l2), iterations, float(weight @ pressure)]


def shown(row):
    """A row of the table."""
    cells = ["-" if row[way] is None else f"{100.0 * row[way][0]:.2g} ({row[way][1]})" for way in WAYS]
    upper, lower = row["upper"], row["lower"]
    apart = "-" if upper is None or lower is None else f"{100.0 * abs(upper[2] / lower[2] - 1.0):.1g}"
    return [row["scene"], row["degree"], f"{row['ratio']:g}", f"{row['friction']:g}", row["facets"], *cells, apart]


def block_rows(args, directory, order, strain, ratios):
    """Rows of the blocks."""
    said = {"heights": (1.0, 0.3), "order": order}
    facets = FACETS if strain == "small" else {name: FACETS[name] for name in ("2:1", "1:2")}
    paths = {
        name: make_mesh(two_blocks, directory / f"{name.replace(':', '_')}_{order}.msh", 2, lower, upper, **said)
        for name, (upper, lower) in list(facets.items())[: 2 if args.tiny else None]
    }
    fine = 24 if args.tiny else FINE
    reference, rows = make_mesh(two_blocks, directory / f"fine_{order}.msh", 2, fine, fine, **said), []
    scene_name = "blocks" if strain == "small" else "blocks, finite strain"
    for ratio, friction in product(ratios, (0.0, 0.5)):
        known = solved(scene(reference, order, ratio, friction, "upper", strain))
        for name, path in paths.items():
            row = {"scene": scene_name, "degree": order, "ratio": ratio, "friction": friction, "facets": name}
            row |= {way: error(solved(scene(path, order, ratio, friction, way, strain)), known) for way in WAYS}
            rows.append(row)
    return rows


def ring_rows(directory, order, strain, ratios):
    """Rows of the rings."""
    rows, scene_name = [], "rings" if strain == "small" else "rings, finite strain"
    for name, mismatch in {"8:13": 13 / 8, "8:5": 5 / 8}.items():
        path = make_mesh(rings, directory / f"rings_{order}_{name[2:]}.msh", n=8, mismatch=mismatch, order=order)
        for ratio, friction in product(ratios, (0.0, 0.5)):
            p = ring_pressure(ratio, RING_LOAD[strain] * min(1.0, ratio))
            known = np.array([-1.0, 2.0]), np.array([p, p])
            row = {"scene": scene_name, "degree": order, "ratio": ratio, "friction": friction, "facets": name}
            row |= {way: error(solved(ring_scene(path, order, ratio, friction, way, strain)), known) for way in WAYS}
            rows.append(row)
    return rows


def run(args):
    """The study, on one rank."""
    directory, rows, orders = make_directory(args.o), [], (1,) if args.tiny else (1, 2)
    ratios = [1e3] if args.tiny else args.ratios
    for order in orders if "small" in args.strains else ():
        rows += block_rows(args, directory, order, "small", ratios)
        rows += ring_rows(directory, order, "small", ratios)
    if "finite" in args.strains:
        ratios = [ratio for ratio in ratios if 1e-3 <= ratio <= 1e3]
        rows += block_rows(args, directory, 1, "finite", ratios) + ring_rows(directory, 1, "finite", ratios)
    print_table("error of the pressure in L2, % (Newton iterations)", HEAD, [shown(row) for row in rows])
    write_json(directory / "swapped.json", rows)
    if args.publish and MPI.COMM_WORLD.rank == 0:
        text = __doc__.strip().split("\n\n")
        command = "    python drivers/studies/swapped.py --publish docs/tables/swapped.md"
        page = ["# Exchanged surfaces", "", text[2], "", text[3], "", command, "",
                "Error of the pressure in L2, %, and Newton iterations.", "",
                *markdown(HEAD, [shown(row) for row in rows]), ""]  # fmt: skip
        with open(args.publish, "w", encoding="utf-8") as file:
            file.write("\n".join(page))
    return 0 if all(row["surfaces"] is not None for row in rows) else 1


if __name__ == "__main__":
    parser = make_parser(__doc__, "swapped")
    parser.add_argument("--ratios", type=float, nargs="+", default=[1e-6, 1e-3, 1.0, 1e3, 1e6])
    parser.add_argument("--strains", nargs="+", default=["small", "finite"], choices=["small", "finite"])
    parser.add_argument("--publish", help="write the table of the docs here")
    main(run, parser)
