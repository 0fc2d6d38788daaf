"""Errors that are named and reached: the true error against the one named.

Every scene of `_named_scenes.py` is run with ``-error`` from its coarse mesh, for all quantities and targets. The
true error of the answer is that against the exact solution, or against a solution of a much smaller error that all
rows of a scene share, see `_named_reference.py`; what that solution may lack is added to the squares. The energy norm
is that of elasticity, of errors and displacements, where bodies yield, too. Pressures are compared in L2, see
`_named_pressure.py`. ``--held`` runs the scenes that were held
back, ``--kept`` takes the references that an earlier run has left beside its rows, ``--cost`` measures the seconds of
the whole loop over those of a run of its last mesh alone, from scratch, without estimate.

On one of two busy cores the rows of a scene in the plane take 5 to 60 s, and its reference 6 to 60 s. Cattaneo and
Mindlin take 1 minute and 50 for the reference (100,000 unknowns, twice); Hertz's ball 4 minutes, the last row of it
2.5, its reference 6 (737,211 unknowns), and some more the distances to it; the cube with sharp edges 1 minute at 20 and
10 % (``--target 0.2 0.1``) and 4 for its reference; the indentation 2 minutes down to 5 % of energy and 2 % of the
force. A row at 2 % of its energy takes hundreds of load steps on 20,000 to 30,000 unknowns, half an hour or more, and a
reference that is several times longer.

    python drivers/studies/named_error.py --scene hill -o hill
    python drivers/studies/named_error.py --scene punch -o punch
    python drivers/studies/named_error.py --join hill punch --publish docs/tables/named_error.md
"""

import time as clock
from dataclasses import replace
from functools import partial
from pathlib import Path

from drivers._common import log, main, print_table, write_json
from drivers.error_norms import bulk_error
from drivers.studies import _named_page as page
from drivers.studies._harness import Rows, solved, study_parser
from drivers.studies._named_pressure import Pressure
from drivers.studies._named_pressure import made as made_pressure
from drivers.studies._named_reference import BUDGET, Reference, made
from drivers.studies._named_scenes import HELD_BACK, SCENES
from drivers.studies._overkill import Overkill
from pcontact.adapt.loop import REACHED, Loop
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.target import Target

TARGETS = (0.1, 0.05, 0.02, 0.01)


class Answer:
    """Values kept of a pass of a loop: as ``take`` of :class:`pcontact.adapt.loop.Loop`.

    Attributes
    ----------
    solution : drivers.studies._overkill.Overkill
        Its displacement.
    laws : list of tuple
        Lame constants of the bodies, and what orthotropic ones add to them or None.
    axisymmetric : bool
    error : float or None
        That of the energy norm against an exact solution, relative.
    pressure : drivers.studies._named_pressure.Pressure or None
    """

    def __init__(self, exact, contact=""):
        self._exact, self.solution, self.laws, self.axisymmetric, self.error = exact, None, [], False, None
        self._contact, self.pressure = contact, None

    @classmethod
    def of(cls, run, converged, exact=None, contact=""):
        """Return the values kept of a pass. *Collective.*"""
        answer = cls(exact, contact)
        answer(run, converged)
        return answer

    def __call__(self, run, converged):
        """Keep it. *Collective.*"""
        if not converged:
            return
        if self._contact:
            self.pressure = Pressure.of(run, self._contact)
        self.solution, space, bulk = Overkill(run), run.problem.space, run.problem.bulk
        self.laws = [(one, bulk.orthotropic.get(body)) for body, one in enumerate(bulk.constants)]
        self.axisymmetric = space.axisymmetric
        if self._exact is not None:
            error = bulk_error(space, bulk.constants, run.stepper.u, self._exact, 2 * space.degree + 2,
                               orthotropic=bulk.orthotropic)  # fmt: skip
            self.error = error.energy / error.energy_of_exact


def cost_of(loop, scene, seconds):
    """Seconds over those of a run on the last mesh alone. *Collective.*"""
    start = clock.perf_counter()
    with solved(scene, loop.mesh):
        return seconds / (clock.perf_counter() - start)


def measure(name, named, of, error, args):
    """A row of the table (a dict), but for the true error, and the answer of the best pass. *Collective.*"""
    scene = scene_of(named, args.o)
    take = partial(Answer.of, exact=named.exact if of == "energy" else None, contact=contact_of(of))
    start = clock.perf_counter()
    loop = Loop(replace(scene, accuracy=Target(error, of, budget=BUDGET)), take=take)
    outcome = loop.run()
    seconds = clock.perf_counter() - start
    row = {"scene": name, "of": of, "target": error}
    if not loop.passes or outcome.failure is not None:
        return row | {"reached": "not converged"}, None
    last, alone = loop.passes[loop.best - 1], loop.best_scene()
    alone.output.estimate = False
    row |= {"reached": "yes" if outcome.status == REACHED else "no", "named": last.error, "estimate": last.expected,
            "unknowns": last.unknowns, "passes": len(loop.passes), "seconds": seconds}  # fmt: skip
    if last.quantity is not None:
        row["value"] = last.quantity["value"]
    if args.cost:
        row["cost"] = cost_of(loop, alone, seconds)
    log.info("%s, %s, target %g: named %.3g, %d unknowns, %.3g s", name, of, error, last.error, last.unknowns, seconds)
    return row, outcome.kept


def contact_of(of):
    """The contact of a pressure; empty where it is another quantity."""
    word, _, name = of.partition(":")
    return name if word == "pressure" else ""


def scene_of(named, folder):
    """A scene with the probes that its quantities need."""
    scene = named.scene(folder).copy()
    scene.output.probes = [of.partition(":")[2] for of in named.quantities if of.startswith("displacement:")]
    return scene


def reference(name, named, args):
    """Return what rows are compared with but for pressures; None where all is known exactly. *Collective.*"""
    wanted = [of for of in named.quantities if of != "energy" and of not in named.known and not contact_of(of)]
    if (not wanted and named.exact is not None) or not asked(named, args, lambda of: not contact_of(of)):
        return None
    if MPI.COMM_WORLD.size > 1:
        raise InputError(f"command line: found {MPI.COMM_WORLD.size} ranks; allowed: one, for {name}")
    path = args.o / f"reference_{name}.npz"
    if not (args.kept and path.exists()):
        start = clock.perf_counter()
        target = 0.1 if args.tiny else args.reference or named.reference
        made(scene_of(named, args.o), target, wanted, named.steps, 0 if args.tiny else named.after).write(path)
        log.info("%s: reference in %.3g s", name, clock.perf_counter() - start)
    return Reference.read(path)


def pressure_reference(name, named, args):
    """Return what pressures are compared with, and what that may lack; None where they are exact, or not asked for.
    *Collective.*"""
    wanted = asked(named, args, lambda of: contact_of(of) and of not in named.known)
    if not wanted:
        return None
    path = args.o / f"reference_{name}_pressure.npz"
    if not (args.kept and path.exists()):
        start = clock.perf_counter()
        found, error = made_pressure(scene_of(named, args.o), named.pressure, contact_of(wanted[0]), named.steps)
        found.write(path, error)
        log.info("%s: reference of the pressure in %.3g s", name, clock.perf_counter() - start)
    return Pressure.read(path)


def asked(named, args, kind):
    """Quantities of a scene that are asked for, of a kind."""
    return [of for of in args.of or named.quantities if kind(of)]


def add_true(row, kept, named, best, pressure):
    """Add the true error to a row, and what the reference has in it. *Collective.*"""
    if kept is None:
        return
    if kept.pressure is not None and row["of"] in named.known:
        found = kept.pressure.off(named.known[row["of"]]), 0.0
    elif kept.pressure is not None:
        found = pressure[0].distance(kept.pressure), pressure[1]
    elif row["of"] == "energy":
        found = kept.error, 0.0
        if named.exact is None:
            found = best.distance(kept.solution.at, kept.axisymmetric, kept.laws), best.error
    else:
        value, lacks = (named.known[row["of"]], 0.0) if row["of"] in named.known else best.values[row["of"]]
        found = abs(row["value"] / value - 1.0), lacks
    row |= {"found": found[0], "reference": found[1], "true": (found[0] ** 2 + found[1] ** 2) ** 0.5}


def run(args):
    """All rows; exit status 1 where more than one in twenty is beyond what was named."""
    if args.join:
        return page.judged(args, page.joined(args.join))
    scenes = HELD_BACK if args.held else SCENES
    names = [name for name in (args.scene or scenes) if name in scenes]
    if len(names) != len(args.scene or names):
        raise InputError(f"command line: --scene: found {args.scene}; allowed: {', '.join(scenes)}")
    kept = Rows(args.o / "rows.jsonl", page.KEYS, args.go_on)
    for name in ["rings"] if args.tiny else names:
        named, wanted = scenes[name], [0.1] if args.tiny else args.target
        quantities = args.of or (named.quantities[:1] if args.tiny else named.quantities)
        own = [measure(name, named, of, target, args) for of in quantities for target in wanted
               if {"scene": name, "of": of, "target": target} not in kept]  # fmt: skip
        if not own:
            continue
        best, pressure = reference(name, named, args), pressure_reference(name, named, args)
        for row, answer in own:
            add_true(row, answer, named, best, pressure)
            kept.add(row)
        print_table("", page.HEAD, [page.line(row) for row, _ in own])
        write_json(args.o / page.FILE, list(kept))
    return page.judged(args, list(kept))


def parser():
    """The driver's options."""
    p = study_parser(__doc__, "named_error_results")
    add = p.add_argument
    add("--scene", nargs="+", help="all, if nothing is said")
    add("--target", type=float, nargs="+", default=list(TARGETS))
    add("--held", action="store_true", help="the scenes that were held back")
    add("--of", nargs="+", help="quantities, in the words of -error_of; all of the scene, if nothing is said")
    add("--reference", type=float, metavar="ERROR", help="of the references; absent: as the scenes have it")
    add("--kept", action="store_true", help="take the references that are there from an earlier run")
    add("--cost", action="store_true", help="what reaching the error costs, too (on a quiet machine)")
    add("--join", type=Path, nargs="+", metavar="DIR", help="no runs: the rows of earlier ones, the later win")
    add("--publish", type=Path, metavar="FILE", help="a page to write the table to")
    add("--picture", type=Path, metavar="FILE", help="a picture of true errors over errors named")
    return p


if __name__ == "__main__":
    main(run, parser())
