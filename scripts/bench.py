"""What contact costs: a ball on a block against one linear elastic solve on the same mesh, in the same run.

    mpirun -n 2 python scripts/bench.py [--unknowns 200000] [--theta 0] [--friction 0.3] [--yield-stress 5]
                                        [--repeat 3] [--impact 100] [any option]
    python scripts/bench.py --against REV [--ranks 2] [--repeat 5] [...]

Both solves use the same Krylov method and preconditioner; the elastic one (body forces, no contact) goes to a relative
tolerance of 1e-8. With --friction the same press is solved with and without it, with --yield-stress with and without
plasticity (perfect, of both bodies). --repeat runs all of them in turn and keeps the fastest of each: other work on the
machine disturbs less. Prints ratios, writes bench.json.

With --impact N the ball hits the block instead: N load steps of the length T / N, T the duration of the impact by
Hertz, and N of a quarter of that; what a load step costs, and Krylov iterations for each linear solve, beside those of
statics.

With --against this tree and the revision REV of it run in alternation, five cases (linear elastic, contact, friction,
plasticity, finite strain) on one mesh, each run in processes of its own; this calls mpirun itself.
"""

import time as clock

import numpy as np

from drivers._common import main, make_mesh, make_parser, print_table, write_json
from drivers.studies._against import against
from drivers.studies._press import make_scene
from drivers.studies.scaling import triad
from meshes import ball_on_block
from pcontact.runtime import log
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Dynamics, Steps
from pcontact.simulation import Simulation

# of the ball that hits the block: its velocity, as a part of sqrt(E / density) [-]
SPEED = 0.01


class Counts(Observer):
    """Iterations of Newton's method and of the linear solvers of all load steps."""

    def __init__(self):
        self.newton = self.krylov = self.steps = 0

    def step(self, step, u, record):
        self.newton, self.krylov, self.steps = (
            self.newton + step.newton, self.krylov + step.krylov, self.steps + 1)  # fmt: skip


def run(description):
    """Run a scene; its timing, counts, and seconds from the first search to the end of the solve."""
    simulation, counts = Simulation(description), Counts()
    begin = clock.process_time()
    if not simulation.run(None, [counts]):
        raise SystemExit(1)
    processor, snes = clock.process_time() - begin, simulation.newton.snes
    timing = simulation.times()
    result = {
        "unknowns": simulation.problem.space.n_dofs,
        "newton": counts.newton,
        "krylov": counts.krylov,
        "steps": counts.steps,
        "processor": simulation.comm.allreduce(processor, op=MPI.MAX),
        "ksp": snes.getKSP().getType(),
        "pc": snes.getKSP().getPC().getType(),
        "solve": timing["search"] + timing["assembly"] + timing["linear"],
        **{key: timing[key] for key in ("setup", "search", "assembly", "linear", "total")},
        "phases": timing["phases"],
        "parallel": simulation.costs.parallel(),
        "memory": simulation.costs.memory(),
    }
    simulation.close()
    return result


def phases(row, unit):
    """Seconds of the phases of a run in units of the linear elastic solve."""
    return {name: seconds / unit for name, seconds in row["phases"].items()}


def print_phases(table):
    """Phases of all runs, a row each."""
    names = list(next(iter(table.values())))
    print_table("phases / linear elastic solve", ["", *names], [
        [case, *(f"{row[name]:.3f}" for name in names)] for case, row in table.items()
    ])  # fmt: skip


def ratios(rows):
    """What the comparison is about, from the rows of the table."""
    contact = rows["contact"]
    result = {
        "contact_to_elastic": contact["solve"] / rows["elastic"]["linear"],
        "assembly_share_of_run": contact["assembly"] / contact["total"],
        "search_share_of_run": contact["search"] / contact["total"],
        "assembly_share_of_solve": contact["assembly"] / contact["solve"],
        "search_share_of_solve": contact["search"] / contact["solve"],
        "phases_to_elastic": {name: phases(row, rows["elastic"]["linear"]) for name, row in rows.items()},
    }
    if "friction" in rows:
        result["friction_to_frictionless"] = rows["friction"]["solve"] / contact["solve"]
    if "plastic" in rows:
        per_step = [row["solve"] / row["newton"] for row in (rows["plastic"], contact)]
        result["plastic_to_elastic_per_newton_step"] = per_step[0] / per_step[1]
    return result


def _keep_fastest(rows, name, row):
    if name not in rows or row["solve"] < rows[name]["solve"]:
        rows[name] = row


def struck(mesh, count, end):
    """The scene of an impact: the ball flies at the block, which it touches at the beginning, for a time."""
    scene = make_scene(mesh, "elastic")
    scene.contacts[0].theta = None
    scene.displacements = scene.displacements[:1]
    for material in scene.materials.values():
        material.density = 1.0
    scene.bodies[0].initial_velocity = [0.0, 0.0, -SPEED * np.sqrt(scene.materials["ball"].E)]
    scene.steps, scene.dynamics = Steps(end, count), Dynamics()
    return scene


def impact(args):
    """The ball hits the block. Returns the exit status."""
    unknowns = 5000 if args.tiny else args.unknowns
    mesh = make_mesh(ball_on_block, args.o / f"ball_{unknowns}.msh", unknowns=unknowns)
    # half a ball of the radius 1, and a block of the same material: E / 2 / (1 - nu^2)
    stiffness, speed = 1e3 / 2.0 / (1.0 - 0.3**2), SPEED * np.sqrt(1e3)
    duration = 2.87 * ((2.0 / 3.0 * np.pi) ** 2 / (stiffness**2 * speed)) ** 0.2
    scenes = {"linear": make_scene(mesh, "linear", 1.0), "contact": make_scene(mesh, "elastic", 1.0)}
    run(scenes["contact"])
    rows = {name: run(scene) for name, scene in scenes.items()}
    for name, end in (("impact", duration), ("impact, short", 0.25 * duration)):
        run(struck(mesh, 1, end / args.impact))
        rows[name] = run(struck(mesh, args.impact, end))
    elastic = rows["linear"]
    print_table("", ["", "steps", "Newton / step", "Krylov / solve", "time / step", "processor time / step"], [
        [name, str(row["steps"]), f"{row['newton'] / row['steps']:.2f}", f"{row['krylov'] / max(row['newton'], 1):.1f}",
         f"{row['solve'] / row['steps'] / elastic['linear']:.2f}",
         f"{row['processor'] / row['steps'] / elastic['processor']:.2f}"] for name, row in rows.items()
    ])  # fmt: skip
    log.info("times in those of one linear elastic solve (rtol 1e-8), %d unknowns", elastic["unknowns"])
    write_json(args.o / "bench_impact.json", {"ranks": MPI.COMM_WORLD.size, **rows})
    return 0


def compare(args):
    """The comparison. Returns the exit status."""
    unknowns = 5000 if args.tiny else args.unknowns
    mesh = make_mesh(ball_on_block, args.o / f"ball_{unknowns}.msh", unknowns=unknowns)
    comm = MPI.COMM_WORLD
    numbers = args.theta, args.friction, args.yield_stress
    scenes = {"contact": make_scene(mesh, "elastic", args.theta)}
    if args.friction:
        scenes["friction"] = make_scene(mesh, "frictional", *numbers)
    if args.yield_stress:
        scenes["plastic"] = make_scene(mesh, "plastic", *numbers)
    # kernels compile (or load) outside the clock
    for case in scenes.values():
        run(case)
    rows = {}
    for _ in range(args.repeat):
        for name, case in scenes.items():
            _keep_fastest(rows, name, run(case))
        contact = rows["contact"]
        _keep_fastest(rows, "elastic", run(make_scene(mesh, "linear", args.theta)))
    result = {"ranks": comm.size, "triad_gb_per_s": triad(comm), **rows, "ratios": ratios(rows)}
    log.info("")
    columns = ("unknowns", "newton", "krylov", "setup", "search", "assembly", "linear", "solve", "total")
    log.info("%-9s" + " %9s" * len(columns), "", *columns)
    for name, row in rows.items():
        cells = [f"{v:9d}" if isinstance(v, int) else f"{v:9.3f}" for v in (row[c] for c in columns)]
        log.info("%-9s %s", name, " ".join(cells))
    log.info("%s + %s, %d ranks, triad %.1f GB/s", contact["ksp"], contact["pc"], comm.size, result["triad_gb_per_s"])
    shares = {key: 100.0 * value for key, value in result["ratios"].items() if "share" in key}
    log.info("whole contact solve / linear elastic solve (rtol 1e-8): %.2f", result["ratios"]["contact_to_elastic"])
    log.info(
        "assembly %.1f %%, search %.1f %% of the run; %.1f %%, %.1f %% of the contact solve", *shares.values()
    )
    print_phases(result["ratios"]["phases_to_elastic"])
    if args.friction:
        log.info("with friction %g / without: %.2f", args.friction, result["ratios"]["friction_to_frictionless"])
    if args.yield_stress:
        found = result["ratios"]["plastic_to_elastic_per_newton_step"]
        log.info("a Newton step with yield stress %g / without: %.2f", args.yield_stress, found)
    write_json(args.o / "bench.json", result)
    return 0


if __name__ == "__main__":
    PARSER = make_parser(__doc__, "bench_results")
    PARSER.add_argument("--unknowns", type=int, default=200_000)
    PARSER.add_argument("--theta", type=float, default=0.0)
    PARSER.add_argument("--friction", type=float, default=0.0)
    PARSER.add_argument("--yield-stress", type=float, default=0.0)
    PARSER.add_argument("--repeat", type=int, default=1)
    PARSER.add_argument("--against", metavar="REV", help="compare with this revision instead; without mpirun")
    PARSER.add_argument("--ranks", type=int, default=2, help="of mpirun, with --against (%(default)s)")
    PARSER.add_argument("--impact", type=int, metavar="N", help="the ball hits the block, in N load steps")
    main(lambda args: against(args) if args.against else impact(args) if args.impact else compare(args), PARSER)
