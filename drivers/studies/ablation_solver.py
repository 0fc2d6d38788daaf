"""Numbers of Newton's method, of load steps and of what they ask of a contact, each over and times 1.5: which of them
change anything.

Scenes of `robustness.py` that take a second or two are run with every number of ``pcontact/solve``,
``pcontact/stepping`` and what contact decides outside of kernels as it is, over 1.5 and times 1.5, as in
`ablation.py`. A row has the largest factor between the Newton iterations of a scene and those with the number as it
is, all Newton and Krylov iterations, cuts, scenes that have not converged, and seconds of the processor.

    python drivers/studies/ablation_solver.py -o DIR
"""

import time as clock
from functools import partial
from importlib import import_module

from drivers._common import log, main
from drivers.studies import ablation
from drivers.studies._robust_scenes import CASES
from drivers.studies.ablation import ablate, write_table
from drivers.studies.robustness import solve
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI

# a scene of each family that is small enough
SCENES = (
    "receding, base 0.1, 10 cells", "roller, h 2", "squeezed plate, 16 cells", "pin, 24 facets",
    "too far, one load step", "lid, 2D, 2 loose", "heap, 2D, no friction", "indentation, axisymmetric, one load step",
    "finite, ring, friction 0.5", "bending, cantilever, one load step", "extremes, near the limit load",
    "extremes, augmented Lagrangian", "extremes, wave pressed flat",
)  # fmt: skip
MODULES = ("solve.convergence", "solve.newton", "solve.preconditioners", "solve.problem", "stepping.load_step",
           "stepping.loose", "stepping.record", "stepping.schedule", "stepping.stepper", "contact.active_set",
           "contact.finite_pair", "contact.pair", "contact.formulation.finite",
           "contact.formulation.methods")  # fmt: skip
# words, the largest number, and what acts only where a message is written
NO_NUMBERS = {"ANY", "ROUNDOFF", "FAILED", "ASKED", "NAMED"}
PAGE = """# Numbers of the solver

`python drivers/studies/ablation_solver.py -o DIR --publish docs/tables/ablation_solver.md` writes this page: what
changes in some scenes of [robustness.md](robustness.md) when a number is over or times 1.5. `newton`: the largest
factor between the Newton iterations of a scene and those with the number as it is; 1: nothing changes. The rest are
sums over all scenes, seconds those of the processor on a busy machine. Numbers that change nothing here are tolerances
that are met with room to spare, limits that these scenes do not meet, and what messages depend on.
"""


def scenes(folder, names=SCENES):
    """What some scenes take."""
    start, rows = clock.process_time(), []
    for case in CASES:
        if f"{case.family}, {case.name}" in names:
            with log.quiet():
                rows.append(solve(case, folder / "run", {}))
    sums = {key: sum(row[key] for row in rows) for key in ("krylov", "cuts")}
    failed = sum(row["ended"] != "converged" for row in rows)
    newton = [row["newton"] for row in rows]
    return {"newton": newton, "all": sum(newton), **sums, "failed": failed, "seconds": clock.process_time() - start}


def run(args):
    """Rows that are missing, and the table."""
    some = [import_module(f"pcontact.{name}") for name in MODULES]
    take = partial(scenes, args.o, ("roller, h 2",) if args.tiny else SCENES)
    # a first time, that compiles
    take()
    found = ablate(args, some, NO_NUMBERS, take, ("newton",), MPI.COMM_WORLD)
    on_root(MPI.COMM_WORLD, write_table, args, PAGE, *found)
    return 0


def parser():
    """The driver's options."""
    return ablation.parser(__doc__, "pcontact_ablation_solver")


if __name__ == "__main__":
    main(run, parser())
