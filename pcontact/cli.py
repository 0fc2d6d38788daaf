"""The command line: ``pcontact run | check | import | convert | refine | view | plot | new | demo | ...``."""

import json
import sys
import time as clock
import traceback
from contextlib import suppress
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np

from pcontact.adapt.passes import wanted
from pcontact.contact.surface.smooth_geometry import SMOOTH, WRONG, facet_pressure
from pcontact.doctor import examine
from pcontact.io.costs import cost_forecast
from pcontact.io.examples import lay_out, write_example, write_template
from pcontact.io.modes import write_modes
from pcontact.io.observers import OUTWARD
from pcontact.io.report import JsonLines, PassLines, read_steps, summary
from pcontact.io.report_schema import report_schema
from pcontact.mesh.distribute import write_plex
from pcontact.mesh.hdf5 import convert, mesh_sizes, write
from pcontact.mesh.mesh import size_of
from pcontact.runtime import log, process
from pcontact.runtime.declared import COMMAND_LINE, CONVERT, DEMO, JSON, MODES, NEW, WARM, read_all
from pcontact.runtime.errors import TOLD, InputError, counted
from pcontact.runtime.files import replace_file
from pcontact.runtime.lock import reserved
from pcontact.runtime.options import Options
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.amplitude import LOOKS, amplitude, corners
from pcontact.scene.reader import read_scene
from pcontact.scene.schema import schema
from pcontact.scene.validate import check_masses
from pcontact.simulation import Simulation
from pcontact.space.modes import component_boxes, near_pairs
from pcontact.usage import COMMANDS, answer, declared, parse
from pcontact.view import show
from pcontact.warm import warm


def _loaded(module):
    """A part of the program that runs do without, by its name: loading all of them takes a tenth of a second."""
    return import_module(f"pcontact.{module}")


def run_scene(scene, directory, observers=(), mesh=None):
    """Build and run a scene. *Collective.*

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
    directory : str, pathlib.Path or None
        None: nothing is written.
    observers : sequence
        Further observers.
    mesh : pcontact.mesh.mesh.Mesh, optional
        Absent: that of the scene's file.

    Returns
    -------
    Simulation, bool
        The simulation, and whether all steps converged.

    Raises
    ------
    InputError
    """
    simulation = Simulation(scene, mesh=mesh)
    converged = simulation.run(directory, observers)
    for line in _unused(simulation):
        log.warning("%s", line)
    return simulation, converged


def check_scene(scene):
    """Print what a scene models, its sizes, what nothing holds. *Collective.*"""
    simulation = Simulation(scene)
    space, mesh, comm = simulation.problem.space, simulation.mesh, simulation.comm
    active, left_out = simulation.describe()
    log.info("%s", simulation.scene.title or "untitled")
    log.info("modelled: %s", "\n          ".join(active))
    log.info("left out: %s", ", ".join(left_out))
    for line in simulation.accuracy.lines():
        log.info("%s", line)
    cells = np.array([comm.allreduce(len(b.nodes)) for b in mesh.blocks])
    for k, body in enumerate(simulation.scene.bodies):
        count = sum(int(n) for n, b in zip(cells, mesh.blocks, strict=True) if b.body == k)
        kinds = sorted({b.cell for n, b in zip(cells, mesh.blocks, strict=True) if b.body == k and n})
        log.info("body %s: %d cells (%s), material %s", body.region, count, ", ".join(kinds), body.material)
    log.info("%d unknowns, degree %d, %s geometry, %d connected bodies", space.n_dofs, space.degree,
             "curved" if mesh.curved else "straight", mesh.n_components)  # fmt: skip
    undeformed = space.vector()
    for contact in simulation.problem.contacts:
        for pair in contact.pairs:
            pair.detect(undeformed, 0.0, 0.0)
        facets, points = (comm.allreduce(len(one)) for one in (contact.source.cells, contact.source.facet))
        low = comm.allreduce(float(np.min(contact.gamma, initial=np.inf)), op=MPI.MIN)
        high = comm.allreduce(float(np.max(contact.gamma, initial=0.0)), op=MPI.MAX)
        if contact.law.tied:
            tied = comm.allreduce(sum(int(np.sum(pair.pairing.paired)) for pair in contact.pairs))
            log.info("contact %s: %d source facets, %d of %d points tied", contact.name, facets, tied, points)
            continue
        log.info(
            "contact %s: %d source facets, %d quadrature points, theta %g, gamma0 %g, gamma %.4g to %.4g "
            "[stress/length], search radius %.4g",
            contact.name, facets, points, contact.method.theta, contact.method.gamma0, low, high,
            contact.pairs[0].radius,
        )  # fmt: skip
        paired, least, most = _gaps(contact, comm)
        if paired:
            log.info("contact %s: %d points have a partner, gaps %.4g to %.4g (negative: overlap)", contact.name,
                     paired, least, most)  # fmt: skip
        else:
            log.info("contact %s: no point has a partner in the undeformed bodies", contact.name)
        if not paired or least > max(pair.search.rounding for pair in contact.pairs):
            _say_distance(simulation, contact, least if paired else _distance(simulation, contact))
        pressure, gap = facet_pressure(contact.pairs)
        if pressure > 0.0:
            log.warning(
                "contact %s: gaps of up to %.2g between straight facets of curved surfaces that conform: a contact "
                "pressure below %.2g comes out wrong by more than %.0f %% (in L2); remedy: %s",
                contact.name, gap, pressure / WRONG, 100.0 * WRONG, SMOOTH,
            )  # fmt: skip
        if contact.contact.all and not contact.rigid:
            low, high = component_boxes(space)
            near = near_pairs(low, high, contact.pairs[0].radius)
            log.info("contact %s: %d surfaces, %d pairs of them near enough to meet%s", contact.name, len(low),
                     len(near), _named(mesh.component_names, near))  # fmt: skip
    held = [name for k, name in enumerate(mesh.component_names) if k not in simulation.floating]
    log.info("held by supports: %s", counted(held) or "no body")
    log.info("costs: %s", "\n       ".join(cost_forecast(simulation.problem, simulation.scene)))
    # a forecast chooses its own options: those that were chosen here are no user's
    simulation.free()


def forecast(scene):
    """Solve on the mesh given and at most one more, print what reaching the error of a scene would take. *Collective.*

    Returns
    -------
    int
        Exit status.
    """
    loop = _loaded("adapt.loop").Loop(scene)
    outcome = loop.forecast()
    if outcome.failure is not None:
        log.error_line(outcome.failure)
        return outcome.status
    for line in loop.ahead.lines(scene.accuracy) if loop.ahead is not None else ():
        log.info("%s", line)
    return 0


def _unused(simulation):
    """Lines about options that nothing asked for, and that were not named when the run began."""
    return simulation.unused(COMMAND_LINE, declared())


def reach(scene, directory, machine):
    """Run a scene until its error is reached. *Collective.*

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
        Of :func:`pcontact.adapt.passes.wanted`.
    directory : str or pathlib.Path
    machine : bool
        Whether the run speaks in lines of JSON.

    Returns
    -------
    int
        Exit status.
    """
    start, lines = clock.perf_counter(), PassLines(machine and MPI.COMM_WORLD.rank == 0)
    adapt = _loaded("adapt.loop")

    def take(simulation, converged):
        if converged:
            lines.passed(loop.passes[-1])
        return _unused(simulation), simulation.records.report

    loop = adapt.Loop(scene, take=take, observers=lambda _: [lines] if machine else [])
    outcome = loop.run(directory)
    unused, kept = outcome.kept
    for line in unused:
        log.warning("%s", line)
    lines.ended(outcome.failure is None, outcome.status == adapt.REACHED)
    say_what_came_out(kept, directory, timing={"total": clock.perf_counter() - start})
    if outcome.failure is not None:
        log.error_line(outcome.failure)
    return outcome.status


def demonstrate(folder):
    """Run an example, and say what its results mean and where they are. *Collective.*

    Parameters
    ----------
    folder : pathlib.Path
        Where scene, mesh and results go.

    Returns
    -------
    int
        Exit status.
    """
    comm = MPI.COMM_WORLD
    path = comm.bcast(on_root(comm, lay_out, "press", folder))
    log.info("the scene is %s; pcontact run %s -o %s/results runs it", path, path, path.parent)
    simulation, converged = run_scene(read_scene(path), path.parent / "results")
    say_what_came_out(simulation.records.report, path.parent / "results")
    for line in on_root(comm, _loaded("demo").explain, path) or ():
        log.info("%s", line)
    simulation.close()
    return 0 if converged else 1


def say_what_came_out(kept, directory, **other):
    """The last lines of a run. Rank 0 speaks.

    Parameters
    ----------
    kept : pcontact.io.report.Report or None
        On rank 0.
    directory : str or pathlib.Path
        Where the run has left its load steps.
    **other
        Entries in place of those of the report.
    """
    if kept is not None:
        for line in summary({**kept.data, **other, "steps": read_steps(directory)}, directory):
            log.info("%s", line)


def _gaps(contact, comm):
    """Number of points with a partner in the undeformed bodies, least and largest gap, whatever acts of it at the
    beginning. *Collective.*"""
    gaps = [(pair.pairing, pair.pairing.gap0 + pair.search.waiting(0.0)) for pair in contact.pairs]
    own = np.concatenate([gap[p.paired] for p, gap in gaps])
    least = comm.allreduce(float(np.min(own, initial=np.inf)), op=MPI.MIN)
    return comm.allreduce(len(own)), least, comm.allreduce(float(np.max(own, initial=-np.inf)), op=MPI.MAX)


def _distance(simulation, contact):
    """Least distance of the surfaces of a contact [length], infinite where they do not face each other.
    *Collective.*"""
    space, least = simulation.problem.space, np.inf
    for pair in contact.pairs:
        found = pair.search.find(space.vector(), 0.0, size_of(simulation.mesh))
        # those that look away from each other lie behind each other
        least = min(least, float(np.min(found.gap[found.paired & (found.gap > 0.0)], initial=np.inf)))
    return space.comm.allreduce(least, op=MPI.MIN)


def _say_distance(simulation, contact, least):
    """Say how far an open contact is, and whether what is prescribed goes as far. *Collective.*"""
    scene, reach = simulation.part, _reach(simulation)
    if least == np.inf:
        log.warning("contact %s: its surfaces do not face each other, however far one looks%s", contact.name,
                    f"; {OUTWARD}" if contact.rigid else "")  # fmt: skip
        return
    line = f"contact {contact.name}: open at first, least distance {least:.4g}"
    loaded = any((scene.loads, scene.temperatures, scene.couplings, scene.pretensions)) or any(
        one.interference_amplitude for one in scene.contacts
    )
    # bodies that have a velocity go anywhere
    says = not simulation.spans and scene.dynamics is None
    if says and reach >= least:
        line += f"; prescribed motions go up to {reach:.4g} and can close it"
    elif says and loaded:
        line += f"; prescribed motions go up to {reach:.4g}, less than that: loads have to close it"
    elif says:
        log.warning("%s; prescribed motions go up to %.4g, less than that, and no load acts: it stays open unless a "
                    "body turns or bends", line, reach)  # fmt: skip
        return
    log.info("%s", line)


def _reach(simulation):
    """Farthest that supports and obstacles go together [length]. *Collective.*"""
    problem, scene, moving = simulation.problem, simulation.part, [0.0]
    times = np.union1d(corners(scene), np.linspace(0.0, scene.steps.end, LOOKS))
    supports = max(problem.space.longest(np.nan_to_num(problem.conditions.supports.values(time))) for time in times)
    for obstacle in (one.obstacle for one in scene.contacts if one.obstacle is not None):
        if obstacle.angle or obstacle.shape == "level_set":
            return np.inf
        factor = amplitude(obstacle.amplitude, scene.steps.end).factor(times)
        moving.append(float(np.max(np.abs(factor))) * float(np.linalg.norm(obstacle.displacement or 0.0)))
    return supports + max(moving)


def _named(names, pairs):
    """Names of pairs of bodies for a message, each once."""
    words = counted([" - ".join(sorted((names[a], names[b]))) for a, b in pairs.tolist()])
    return f": {words}" if words else ""


def convert_mesh(path, options):
    """Write a mesh for reading in parallel, and say what it holds. *Collective.*"""
    name = next((name for name in ("order", "mesh_order") if name in options), "order")
    order = replace(CONVERT["order"], name=name).read(options.get(name, "1"))

    petsc = CONVERT["petsc"].read(options.get("petsc", "false"))

    def work():
        target, raw = convert(path, options.get("o"), order, write_plex if petsc else write)
        return target, mesh_sizes(raw)

    target, sizes = on_root(MPI.COMM_WORLD, work) or (None, None)
    log.info("wrote %s: %s", target, sizes)


def vibrate(scene, directory, count):
    """Solve, and say and write the modes of vibrations about the state. *Collective.*

    Returns
    -------
    int
        Exit status.
    """
    check_masses(scene)
    simulation, converged = run_scene(scene, directory)
    if converged:
        squares, shapes = simulation.modes(count)
        rows = write_modes(directory, simulation, squares, shapes)
        for number, row in enumerate(rows, 1):
            log.info("mode %d: frequency %.6g%s", number, row["frequency"], "" if row["stable"] else ", unstable")
    simulation.close()
    return 0 if converged else 1


def print_schema(path=None, of="scene"):
    """Print the JSON Schema of a scene file or of a report, or write it. *Collective.*"""
    words = json.dumps(schema() if of == "scene" else report_schema(), indent=2)
    if path is None:
        log.info("%s", words)
        return
    on_root(MPI.COMM_WORLD, replace_file, path, words + "\n")
    log.info("wrote %s", path)


def _execute(command, operand, options):
    if (words := answer(command, operand)) is not None:
        log.info("%s", words)
        return 0
    operands, sets = operand if isinstance(operand, list) else [operand], options.pop("set", [])
    for word in filter(None, (*operands, *options.values(), *sets)):
        _check_letters(word)
    comm = MPI.COMM_WORLD
    if command in ("view", "plot"):
        written = on_root(comm, show.show if command == "view" else show.plot_history, operand, options)
        if written is not None:
            log.info("wrote %s", written)
        return 0
    if command == "new":
        example = read_all(command, NEW, options).get("example")
        work = (write_template, operand) if example is None else (write_example, operand, example)
        log.info("wrote %s; its first lines say what to do", on_root(comm, *work))
        return 0
    if command == "demo":
        return demonstrate(Path(read_all(command, DEMO, options).get("o", "demo")))
    if command == "warm":
        log.info("%s", on_root(comm, lambda: warm(**read_all(command, WARM, options))))
        return 0
    if command == "doctor":
        read_all(command, {}, options)
        for line in examine():
            log.info("%s", line)
        return 0
    if command == "refine":
        log.info("wrote %s", _loaded("io.refine").refine_run(operand, options, comm))
        return 0
    if command == "import":
        return comm.bcast(on_root(comm, _loaded("importer.translate").import_file, operand, options.get("o")), root=0)
    if command == "convert":
        convert_mesh(operand, options)
        return 0
    if command == "schema":
        values = read_all(command, COMMANDS[command].options, options)
        print_schema(values.get("o"), values.get("of", "scene"))
        return 0
    scene = read_scene(operand, words=sets)
    if command == "check":
        aimed = wanted(scene, Options())
        check_scene(scene)
        return 0 if aimed is None else forecast(aimed)
    directory = options.get("o") or Path(operand).stem + "_results"
    # a place that cannot be written to is told before the mesh is read
    with reserved(directory, comm):
        pass
    if command == "modes":
        return vibrate(scene, Path(directory), MODES["count"].read(options.get("count", str(MODES["count"].default))))
    aimed = wanted(scene, Options())
    machine = JSON["json"].read(options.get("json", "false"))
    if machine:
        log.setup(comm.rank, level="error")
    if aimed is not None:
        return reach(aimed, directory, machine)
    simulation, converged = run_scene(scene, directory, [JsonLines(comm.rank == 0)] if machine else [])
    if not machine:
        say_what_came_out(simulation.records.report, directory)
    simulation.close()
    return 0 if converged else 1


def _check_letters(word):
    """Refuse a name whose bytes are not text for Python: neither a mesh reader nor a report could take it."""
    try:
        word.encode("utf-8")
    except UnicodeEncodeError:
        code = sys.getfilesystemencoding()
        raise InputError(
            f"command line: found {ascii(word)}, which cannot be read as {code}; allowed: names in the encoding of the "
            "locale (a UTF-8 locale, or PYTHONUTF8=1, has all letters)"
        ) from None


def guarded(function, *args):
    """Run a program: what the user is told of ends with one line and the same status on every rank.

    That is 2 for wrong input, 3 for output that cannot be written. Anything else stops every rank; where memory ends,
    one line says so, and the status is 1.

    Parameters
    ----------
    function : callable
        Returns the exit status.

    Returns
    -------
    int
    """
    comm = MPI.COMM_WORLD
    log.setup(comm.rank)
    try:
        with process.stopping(comm.rank == 0):
            return function(*args)
    except TOLD as error:
        log.error_line(error)
        return error.status
    except SystemExit:
        raise
    except MemoryError as error:
        # whichever rank it is, while the others wait for it
        log.setup(comm.rank, all_ranks=comm.size > 1)
        log.error_line(f"out of memory: {error or 'no more to be had'}; remedy: a coarser mesh, a machine with more, "
                       "or more of them; docs/howto/memory.md says what needs it")
        if comm.size > 1:
            comm.Abort(1)
        return 1
    except BaseException:
        with suppress(OSError, ValueError):
            traceback.print_exc()
            sys.stderr.flush()
        if comm.size > 1:
            comm.Abort(1)
        return 1


def main(arguments=None):
    """Entry point of ``pcontact``."""
    arguments = sys.argv[1:] if arguments is None else arguments
    status = guarded(lambda: _execute(*parse(arguments)))
    log.finish()
    sys.exit(status)
