"""What it costs to refine a mesh and to spread it over the ranks anew, beside the solve on the refined mesh.

Two blocks of tetrahedra are pressed on each other on a mesh of about a million cells. Its cells are cut where the error
estimate is large, until there are twice as many; the displacement is interpolated, the new mesh is spread over the
ranks by work and contact, and the run on it begins where the last one has ended.
"""

import time as clock

from drivers._common import log, main, make_mesh, make_parser, print_table, write_json
from drivers.studies._harness import composed
from meshes import two_blocks
from pcontact import build
from pcontact.adapt.mark import Contributions, cuts
from pcontact.adapt.passes import Beginning, Known, Watch
from pcontact.mesh.refinement.refine import Balance, refine
from pcontact.runtime.errors import StepFailure
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact, Material, Output
from pcontact.simulation import Simulation

# [-] Cells that are cut because they are wanted smaller, and all: neighbours follow.
FOLLOWERS = 1.25
PRESSED = 0.02


def blocks(path):
    """The scene: the upper block is pressed on the lower one, and both are held at their sides."""
    return composed(
        path,
        {"lower": Material(10.0, 0.3), "upper": Material(30.0, 0.3)},
        {"lower_bottom": [0.0, 0.0, 0.0], "upper_top": [0.0, 0.0, -PRESSED]},
        title="blocks of tetrahedra",
        contacts=[Contact("upper_bottom", "lower_top", name="face")],
        output=Output(fields=False, estimate=True),
    )


def solved(scene, mesh=None, known=None):
    """A run in memory, and, with an estimate, what it tells of its cells. *Collective.*"""
    simulation = Simulation(scene, mesh=mesh)
    if known is not None:
        simulation.begin = Beginning(simulation, known)
    watch = Watch(simulation) if scene.output.estimate else None
    if not simulation.run(None, [] if watch is None else [watch]):
        raise StepFailure(str(simulation.failure))
    return simulation, watch


def balance_of(mesh):
    """Cells of the rank that has most, over the mean. *Collective.*"""
    own = sum(len(block.nodes) for block in mesh.blocks)
    return mesh.comm.allreduce(own, op=MPI.MAX) * mesh.comm.size / mesh.n_cells_total


def run(args):
    """Solve, refine, solve again; exit status."""
    comm = MPI.COMM_WORLD
    n = 3 if args.tiny else args.n
    scene = blocks(make_mesh(two_blocks, args.o / f"blocks_{n}.msh", 3, n, n + 1, "tetrahedron"))
    first, watch = solved(scene)
    mesh, unknowns, before = first.mesh, first.problem.space.n_dofs, first.times()
    step = cuts(comm, Contributions(watch.squares, 1, 3), 0.0, args.growth / FOLLOWERS)
    spread = Balance(*build.balance(first.scene, Options()))
    first.free()
    del first
    comm.barrier()
    begun = clock.perf_counter()
    finer, fields = refine(mesh, step.more, watch.fields, spread)
    comm.barrier()
    seconds = clock.perf_counter() - begun
    log.info("refined and spread over %d ranks in %.3g s", comm.size, seconds)
    scene.output.estimate = False
    second, _ = solved(scene, finer, Known(watch.times, fields))
    after = second.times()
    rows = [[mesh.n_cells_total, unknowns, balance_of(mesh), before["solve"], before["total"]],
            [finer.n_cells_total, second.problem.space.n_dofs, balance_of(finer), after["solve"], after["total"]]]
    second.free()
    print_table("runs", ("cells", "unknowns", "imbalance", "solve", "total"), rows)
    log.info("refinement: %.3g of the solve on the refined mesh", seconds / after["solve"])
    write_json(args.o / "refining.json", {"ranks": comm.size, "rows": rows, "refine": seconds})
    return 0


def parser():
    """The driver's options."""
    p = make_parser(__doc__, "refining_results")
    add = p.add_argument
    add("--n", type=int, default=43, help="cells along an edge of the lower block; the upper one has one more")
    add("--growth", type=float, default=2.0, help="cells of the refined mesh over those of the first one (2)")
    return p


if __name__ == "__main__":
    main(run, parser())
