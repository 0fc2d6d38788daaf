"""What a cell costs that is elastic, that may yield, and that yields: seconds per Newton step and bytes.

    python scripts/bench_cells.py [--cells 20000] [-o DIR]

One body, one rank. Time: residual and tangent of the bulk item at a displacement, the fastest of five; the assembly of
the global matrix, which all three share, comes on top. Bytes: internal variables. Prints a table, writes cells.json.
"""

import time

import numpy as np

from drivers._common import main, make_mesh, make_parser, print_table, write_json
from meshes import one_block
from pcontact.scene.model import Body, Displacement, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation

KINDS = [("quadrilateral", 1), ("triangle", 2), ("hexahedron", 1), ("tetrahedron", 1), ("tetrahedron", 2)]
YIELD = {"elastic": None, "may yield": 1e12, "yields": 1e-3}


def divisions(cell, cells):
    """Divisions of a unit box that make about as many cells."""
    dim = 2 if cell in ("triangle", "quadrilateral") else 3
    per_box = {"triangle": 2, "quadrilateral": 1, "hexahedron": 1, "tetrahedron": 6}[cell]
    return dim, max(1, round((cells / per_box) ** (1.0 / dim)))


def measure(bulk, u):
    """Seconds of a residual and a tangent, each the fastest of five."""
    out, best = np.zeros((bulk.space.n_owned, bulk.space.dim)), [np.inf, np.inf]
    for _ in range(5):
        for k, work in enumerate((lambda: bulk.residual(u, out), lambda: bulk.tangent(u))):
            start = time.perf_counter()
            work()
            best[k] = min(best[k], time.perf_counter() - start)
    return best


def run(args):
    """The table."""
    rows = []
    for cell, degree in KINDS:
        dim, n = divisions(cell, 200 if args.tiny else args.cells)
        mesh = make_mesh(one_block, args.o / f"{cell}.msh", dim, n, cell)
        for kind, stress in YIELD.items():
            case = Scene(
                mesh=MeshSpec(mesh, order=degree),
                materials={"m": Material(1000.0, 0.3, yield_stress=stress)},
                bodies=[Body("block", "m")],
                displacements=[Displacement("bottom", [0.0] * dim)],
                output=Output(fields=False),
            )
            simulation = Simulation(case)
            bulk, space = simulation.problem.items[0], simulation.problem.space
            u = space.vector()
            u.setArray((space.points[space.owned_local] * np.linspace(0.01, -0.02, dim)).ravel())
            residual, tangent = measure(bulk, u)
            count = sum(len(cells) for cells in space.cells)
            size = sum(s.values.nbytes for s in bulk.states.values())
            rows.append({
                "cell": cell, "degree": degree, "kind": kind, "cells": count,
                "residual_us": 1e6 * residual / count, "tangent_us": 1e6 * tangent / count, "bytes": size / count,
            })  # fmt: skip
            simulation.close()
    columns = ["cell", "degree", "kind", "cells", "residual_us", "tangent_us", "bytes"]
    print_table("microseconds and bytes per cell", columns, [[row[c] for c in columns] for row in rows])
    write_json(args.o / "cells.json", rows)
    return 0


if __name__ == "__main__":
    parser = make_parser(__doc__, "bench_cells_results")
    parser.add_argument("--cells", type=int, default=20_000, help="cells of each kind")
    main(run, parser)
