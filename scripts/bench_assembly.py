"""How near to the roof assembly runs: seconds, unknowns per second, and bytes against the memory bandwidth.

    mpirun -n 2 python scripts/bench_assembly.py [--unknowns 200000] [--friction 0.3 | --yield-stress 5] [-o DIR]

The ball on the block is solved; at the solution every kernel of a Newton step runs five times on all ranks together,
and the fastest counts. Bytes are those that the kernel cannot do without: its arrays read or written once (what it adds
to, twice). The roof is the triad of the same run; the product of the matrix with a vector by PETSc stands beside it.
Prints a table, writes assembly.json.
"""

import numpy as np

from drivers._common import main, make_mesh, make_parser, print_table, write_json
from drivers.studies._press import make_scene
from drivers.studies.scaling import triad
from meshes import ball_on_block
from pcontact.assembly.solid import Solid
from pcontact.runtime.petsc import MPI
from pcontact.simulation import Simulation


def nbytes(*things):
    """Bytes of arrays, of lists of them, and of those that are attributes of an object."""
    total = 0
    for thing in things:
        if isinstance(thing, np.ndarray):
            total += thing.nbytes
        elif isinstance(thing, (list, tuple)):
            total += nbytes(*thing)
        elif hasattr(thing, "__dict__"):
            total += nbytes(*(part for part in vars(thing).values() if isinstance(part, np.ndarray)))
    return total


def fastest(comm, work):
    """Seconds of the slowest rank, the fastest of five."""
    best = np.inf
    for _ in range(5):
        comm.Barrier()
        start = MPI.Wtime()
        work()
        best = min(best, comm.allreduce(MPI.Wtime() - start, op=MPI.MAX))
    return best


def kernels(simulation):
    """Name, work and bytes of what a Newton step consists of, at the solution."""
    problem, space, u = simulation.problem, simulation.problem.space, simulation.stepper.u
    bulk, contact, matrix = problem.bulk, problem.others[0], problem.matrix
    f, y = space.vector(), space.vector()
    out = np.zeros((space.n_owned, space.dim))
    values, blocks = contact.tangent(u), bulk.tangent(u)
    points = nbytes(contact.source, contact.pairing)
    scalars = matrix.matrix.getInfo()["nz_used"]
    geometry = nbytes(space.points, space.cells)

    def whole():
        # a view is not the object that was written last: all rows are written
        matrix.write(blocks.view(), problem._sum([values]), problem.stabilisation)

    result = {
        "stiffness of the bodies, from scratch": (
            lambda: Solid(space, bulk.materials), geometry + 2 * nbytes(bulk.values)
        ),
        "bulk residual": (lambda: bulk.residual(u, out), nbytes(bulk.values, bulk.columns, out) + out.nbytes),
        "matrix, all rows": (whole, 2 * nbytes(blocks) + nbytes(matrix._at, matrix._rows.columns)),
        "matrix, rows of contact": (
            # the first of the five writes all rows
            lambda: matrix.write(blocks, problem._sum([values]), problem.stabilisation), 2 * nbytes(values)
        ),
        "contact residual": (lambda: contact.residual(u, out), points),
        "contact tangent": (lambda: contact.tangent(u), points + 2 * nbytes(values)),
        "product with the matrix (PETSc)": (lambda: matrix.matrix.mult(u, y), scalars * 12 + 2 * out.nbytes),
    }
    if hasattr(bulk, "predict"):
        result["bulk tangent"] = (lambda: bulk.tangent(u), 2 * nbytes(blocks))
    f.destroy()
    return result


def run(args):
    """The table."""
    comm = MPI.COMM_WORLD
    unknowns = 5000 if args.tiny else args.unknowns
    mesh = make_mesh(ball_on_block, args.o / f"ball_{unknowns}.msh", unknowns=unknowns)
    case = "plastic" if args.yield_stress else "frictional" if args.friction else "elastic"
    simulation = Simulation(make_scene(mesh, case, args.theta, args.friction, args.yield_stress))
    if not simulation.run(None):
        return 1
    roof, rows = triad(comm, 20_000 if args.tiny else 20_000_000), []
    count = simulation.problem.space.n_dofs
    for name, (work, size) in kernels(simulation).items():
        seconds = fastest(comm, work)
        rate = comm.allreduce(size, op=MPI.SUM) / seconds / 1e9
        rows.append({
            "kernel": name, "seconds": seconds, "million_unknowns_per_s": count / seconds / 1e6, "gb_per_s": rate,
            "part_of_triad": rate / roof,
        })  # fmt: skip
    simulation.close()
    table = [
        [row["kernel"], f"{row['seconds']:.4f}", f"{row['million_unknowns_per_s']:.2f}", f"{row['gb_per_s']:.2f}",
         f"{100.0 * row['part_of_triad']:.0f} %"]
        for row in rows
    ]  # fmt: skip
    title = f"{count} unknowns, {comm.size} ranks, triad {roof:.1f} GB/s"
    print_table(title, ["kernel", "seconds", "million unknowns / s", "GB/s", "of the triad"], table)
    write_json(args.o / "assembly.json", {"ranks": comm.size, "unknowns": count, "triad_gb_per_s": roof, "rows": rows})
    return 0


if __name__ == "__main__":
    parser = make_parser(__doc__, "bench_assembly_results")
    add = parser.add_argument
    add("--unknowns", type=int, default=200_000)
    add("--theta", type=float, choices=(1.0, 0.0, -1.0), default=0.0)
    law = parser.add_mutually_exclusive_group()
    law.add_argument("--friction", type=float)
    law.add_argument("--yield-stress", type=float)
    main(run, parser)
