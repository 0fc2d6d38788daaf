"""What all drivers share: command line, mesh on rank 0, one run after the other, tables, JSON, plots.

A driver is a function of its parsed arguments that returns the exit status::

    def run(args):
        path = make_mesh(rings, args.o / "rings.msh", n=args.n)
        with running(scene(path), args.o / "run") as (simulation, converged):
            ...
        return 0

    if __name__ == "__main__":
        main(run, make_parser(__doc__, "rings_results"))

Options of a driver have two dashes; every other option is left to the options database of PETSc.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pcontact.cli import guarded, run_scene
from pcontact.mesh.mesh import Mesh
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.runtime.rules import is_number
from pcontact.scene.model import Scene
from pcontact.simulation import Simulation
from pcontact.view import extra


class _Parser(argparse.ArgumentParser):
    """Reports what is wrong as an input error: one line, rank 0, status 2."""

    def error(self, message):
        raise InputError(f"command line: {message}")

    def _print_message(self, message, file=None):
        if MPI.COMM_WORLD.rank == 0:
            super()._print_message(message, file)


def make_parser(description: str, directory: str, tiny: bool = True) -> argparse.ArgumentParser:
    """Parser with what every driver has: ``-o DIR`` and ``--tiny``.

    Parameters
    ----------
    description : str
        The driver's docstring; its first paragraph is shown.
    directory : str
        Default of ``-o``.
    tiny : bool
        Whether the driver has ``--tiny``.
    """
    parser = _Parser(
        description=description.strip().split("\n\n")[0],
        epilog="All other options (one dash) are pcontact's and PETSc's: -contact_gamma0 2 -snes_monitor ...",
        allow_abbrev=False,
    )
    text = "results (default: %(default)s)"
    parser.add_argument("-o", type=Path, default=Path(directory), metavar="DIR", help=text)
    if tiny:
        parser.add_argument("--tiny", action="store_true", help="a run of a few seconds: does it all work?")
    return parser


def _own_words(words):
    """Words of the command line that are the driver's: options with two dashes, -o, -h, and their values."""
    own, mine = [], True
    for word in words:
        if word.startswith("-") and not is_number(word):
            mine = word.startswith("--") or word in ("-o", "-h")
        if mine:
            own.append(word)
    return own


def parse(parser: argparse.ArgumentParser, words: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse the driver's own options and take them out of the options database (they would be called unused).

    Raises
    ------
    InputError
        On every rank.
    """
    args, others = parser.parse_known_args(_own_words(sys.argv[1:] if words is None else words))
    if others and not others[0].startswith("-"):
        raise InputError(f"command line: found {others[0]!r}, allowed: options only, see --help")
    database = PETSc.Options()
    for action in parser._actions:
        for option in action.option_strings:
            database.delValue(option if option.startswith("--") else option.lstrip("-"))
    return args


def main(run: Callable[[argparse.Namespace], int], parser: argparse.ArgumentParser) -> None:
    """Parse, make the output directory, run, and leave with pcontact's exit status. *Collective.*

    Parameters
    ----------
    run : callable
        From the parsed arguments to the exit status: 0, or 1 when a step did not converge.
    parser : argparse.ArgumentParser
    """

    def work():
        args = parse(parser)
        make_directory(args.o)
        return run(args)

    status = guarded(work)
    sys.stdout.flush()
    sys.exit(status)


def _mkdir(path):
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        text = f"command line: -o {path}: found {error.strerror}, allowed: a directory to write to"
        raise InputError(text) from None


def make_directory(path: str | Path) -> Path:
    """Make a directory on rank 0; it is there on every rank afterwards. *Collective.*"""
    path = Path(path)
    on_root(MPI.COMM_WORLD, _mkdir, path)
    return path


def make_mesh(generator: Callable, path: str | Path, *args, **options) -> Path:
    """Write a mesh on rank 0 while the others wait. *Collective.*

    Parameters
    ----------
    generator : callable
        Of :mod:`meshes`; called as ``generator(path, *args, **options)``.
    path : file to write

    Raises
    ------
    InputError
        When the generator refuses its arguments.
    """

    def work():
        try:
            generator(path, *args, **options)
        except (ValueError, RuntimeError) as error:
            raise InputError(str(error)) from error

    on_root(MPI.COMM_WORLD, work)
    return Path(path)


@contextmanager
def running(
    scene: Scene, directory: str | Path | None = None, observers: Sequence[object] = (), mesh: Mesh | None = None
) -> Iterator[tuple[Simulation, bool]]:
    """Run a scene; at the end of the block its solver defaults leave the options database. *Collective.*

    Parameters
    ----------
    scene : Scene
    directory : str, pathlib.Path or None
        Where the run's report, history and fields go; None: nothing is written.
    observers : sequence
        Further observers, see :class:`pcontact.runtime.observer.Observer`.
    mesh : pcontact.mesh.mesh.Mesh, optional
        Absent: that of the scene's file.

    Yields
    ------
    Simulation, bool
        The simulation (``stepper.u`` holds the solution), and whether all steps converged.
    """
    simulation, converged = run_scene(scene, directory, observers, mesh)
    try:
        yield simulation, converged
    finally:
        simulation.close()


def contact_points(simulation: Simulation, number: int = 0) -> dict[str, np.ndarray] | None:
    """Values at all quadrature points of a contact pair, gathered on rank 0 for a plot. *Collective.*

    Parameters
    ----------
    simulation : Simulation
    number : int
        Of the pair in the scene.

    Returns
    -------
    dict of str to ndarray, or None on other ranks
        What :meth:`pcontact.contact.pair.ContactPair.state` returns, sorted by position.
    """
    state = simulation.problem.contacts[number].state(simulation.stepper.u)
    parts = simulation.comm.gather(state, root=0)
    if parts is None:
        return None
    joined = {key: np.concatenate([part[key] for part in parts]) for key in state}
    order = np.lexsort(joined["x"].T[::-1])
    return {key: value[order] for key, value in joined.items()}


def observed_rates(sizes: Sequence[float], errors: Sequence[float]) -> list[float]:
    """Orders of convergence between one mesh and the next; NaN for the first.

    Parameters
    ----------
    sizes : mesh sizes
    errors : positive errors, one per size
    """
    h, e = np.log(np.asarray(sizes, dtype=float)), np.log(np.asarray(errors, dtype=float))
    return [float("nan"), *(np.diff(e) / np.diff(h)).tolist()]


def _cell(value):
    if isinstance(value, float):
        if np.isnan(value):
            return "-"
        return f"{value:.5g}"
    return str(value)


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Log a table with aligned columns (rank 0 speaks); floats have five digits."""
    words = [list(header), *([_cell(value) for value in row] for row in rows)]
    widths = [max(len(row[k]) for row in words) for k in range(len(header))]
    log.info("%s", title)
    for row in words:
        log.info("  %s", "  ".join(word.rjust(width) for word, width in zip(row, widths, strict=True)))


def markdown(header: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    """Lines of a table in Markdown; floats have five digits."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return lines + ["| " + " | ".join(_cell(value) for value in row) + " |" for row in rows]


def plain(value):
    """Numpy's scalars and arrays, and paths, for JSON."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return str(value)


def write_json(path: str | Path, data: object) -> None:
    """Write data (numpy allowed) as JSON on rank 0; what is not a number becomes null."""
    if MPI.COMM_WORLD.rank == 0:
        clean = json.loads(json.dumps(data, default=plain), parse_constant=lambda _: None)
        Path(path).write_text(json.dumps(clean, indent=1) + "\n")


def draw(
    path: str | Path, paint: Callable, columns: int = 1, size: tuple[float, float] = (5.5, 4.2), rows: int = 1,
    dpi: int = 150,
) -> None:  # fmt: skip
    """Write a plot on rank 0.

    Parameters
    ----------
    path : PNG file
    paint : callable
        Called on rank 0 only as ``paint(axes)``, with one matplotlib Axes, or an array of several.
    columns : int
        Axes side by side.
    size : (float, float)
        Of one of them [inch].
    rows : int
        Of axes, one below the other.
    dpi : int
        Pixels per inch.
    """
    if MPI.COMM_WORLD.rank == 0:
        figure = Figure(figsize=(size[0] * columns, size[1] * rows), layout="constrained")
        paint(figure.subplots(rows, columns))
        figure.savefig(path, dpi=dpi)


def picture(directory: str | Path, **view: object) -> None:
    """Draw results as ``pcontact view`` does, if what draws is installed. Serial.

    Parameters
    ----------
    directory : of a run
    **view
        Parameters of :func:`pcontact.view.picture.picture`.
    """
    if extra.missing():
        log.info("no picture of %s: the extra `view` is not installed", directory)
        return
    extra.prepare_off_screen()
    # VTK is imported here only
    from pcontact.view.picture import picture as drawn

    drawn(directory, **view)


__all__ = [
    "contact_points",
    "draw",
    "log",
    "main",
    "make_directory",
    "make_mesh",
    "make_parser",
    "markdown",
    "observed_rates",
    "parse",
    "picture",
    "plain",
    "print_table",
    "running",
    "write_json",
]
