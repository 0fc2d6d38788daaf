"""The words of the command line: commands, what ``--help`` says, and what was asked for. Without the solver."""

from dataclasses import replace
from typing import NamedTuple

from pcontact import __version__
from pcontact.runtime.declared import (
    CONVERT,
    DEMO,
    IMPORT,
    JSON,
    MODES,
    NEW,
    OPTIONS,
    PLOT,
    REFINE,
    SCHEMA,
    SECTIONS,
    SET,
    VIEW,
    WARM,
    help_lines,
    listed,
)
from pcontact.runtime.errors import InputError, nearby
from pcontact.runtime.rules import is_number
from pcontact.scene.keys import options as key_options
from pcontact.scene.model import Contact, MeshSpec, Output, Scene, Steps
from pcontact.scene.target import Budget, Target

PETSC_HELP = """\
  -snes_monitor, -snes_rtol X, -snes_linesearch_type bt|cp|basic|l2, -ksp_type, -pc_type gamg|hypre|ml|lu, ...
                                                   any option of PETSc; -help with a scene lists them"""
EXIT = """\
Exit status: 0 all steps converged, 1 a step did not converge, 2 the input is wrong, 3 output cannot be written or
another run writes there, 4 the error to reach (-error) was not reached, 130 or 143 stopped by Ctrl-C or SIGTERM."""


class Command(NamedTuple):
    """A command.

    Attributes
    ----------
    operand : str
        What it is called with, for messages; empty: nothing.
    usage, help : str
        Its words, and what it does.
    options : dict of str to Option or None
        Those that it takes; None: those of a run.
    many : bool
        Whether it takes several operands, at least two.
    """

    operand: str
    usage: str
    help: str
    options: dict | None = None
    many: bool = False


COMMANDS = {
    "run": Command("a scene file", "SCENE.toml [-o DIR] [options]", "solve; results in DIR (default: SCENE_results)"),
    "check": Command("a scene file", "SCENE.toml [options]",
                     "what is modelled; solves nothing (with -error coarse meshes)"),
    "modes": Command("a scene file", "SCENE.toml [-count N] [options]",
                     "solve, then modes of vibrations about the state"),
    "import": Command(
        "a deck", "DECK [-o DIR]", "a scene with its mesh from a deck of Abaqus or CalculiX (.inp)", IMPORT
    ),
    "convert": Command("a mesh file", "MESH [-o FILE.h5] [--order 2]", "a mesh for reading in parallel", CONVERT),
    "refine": Command(
        "a directory", "DIR [-o FILE.msh] [options]",
        "a finer mesh where the error estimate of the run in DIR is large", REFINE,
    ),
    "view": Command(
        "a directory", "DIR [-field NAME] [-o FILE]",
        "the deformed bodies: window, picture, page, animation", VIEW,
    ),
    "plot": Command(
        "a directory and columns of its history", "DIR [X] Y [Y ...]",
        "columns Y of the history over X, or over the time", PLOT, many=True,
    ),
    "new": Command("the name of a directory", "NAME [-example EXAMPLE]",
                   "a commented scene with its mesh to start from, or an example", NEW),
    "demo": Command("", "[-o DIR]", "a first look: a ball is pressed on a block; what came out", DEMO),
    "warm": Command("", "[-jobs N]", "what runs would compile at first is compiled now", WARM),
    "doctor": Command("", "", "what is installed, how fast this machine is, what to do", listed()),
    "schema": Command(
        "", "[-of report] [-o FILE.json]", "JSON Schema of a scene file, for editors, or of report.json",
        SCHEMA,
    ),
}  # fmt: skip


def run_options():
    """The options of a run, by section: a title and the options.

    Returns
    -------
    dict of str to list of Option
    """
    tables = (Scene, Target, Budget, MeshSpec, Contact, Steps, Output)
    scene = [option for cls in tables for option in key_options(cls).values()]
    every = [replace(option, default=None, otherwise="") for option in scene] + list(OPTIONS.values())
    return {title: [option for option in every if option.section == name] for name, title in SECTIONS.items()}


def usage(command=None):
    """Return the text of ``--help``.

    Parameters
    ----------
    command : str, optional
        Absent: of all commands.
    """
    named = COMMANDS if command is None else {command: COMMANDS[command]}
    lines = [f"pcontact {__version__}: contact between elastic bodies with Nitsche's method, in parallel on PETSc", ""]
    lines += [f"  pcontact {f'{name} {one.usage}':<39} {one.help}" for name, one in named.items()]
    if command in (None, "run"):
        lines += ["  mpirun -n 4 pcontact run SCENE.toml ...          the same on four ranks"]
    lines += ["  pcontact COMMAND --help                          the options of a command"] * (command is None)
    lines += [""]
    if any(one.options is None for one in named.values()):
        lines += ["Options of run and check. They win over the scene; its [petsc] table wins over defaults."]
        lines += help_lines([*SET.values(), *JSON.values(), *(MODES.values() if command == "modes" else ())])
        for title, options in run_options().items():
            lines += [f"{title}:", *help_lines(options)]
        lines += ["Of PETSc:", PETSC_HELP]
    for name, one in named.items():
        if one.options:
            lines += [f"Options of {name}:", *help_lines(one.options.values())]
    return "\n".join([*lines, EXIT])


def answer(command, about=None):
    """Return the text that ``help``, of all commands or `about` one, and ``version`` print; None of other commands."""
    if command == "help":
        return usage(about)
    return f"pcontact {__version__}" if command == "version" else None


def parse(arguments):
    """Command, its operand and our own options from the command line.

    Parameters
    ----------
    arguments : list of str

    Returns
    -------
    command : str
    operand : str, list of str or None
        A list of a command that takes several.
    options : dict of str to str
        With a list of all values of ``-set``.

    Raises
    ------
    InputError
    """
    if not arguments or arguments[0].lstrip("-") in ("h", "help"):
        return "help", next((one for one in arguments[1:] if one in COMMANDS), None), {}
    if arguments[0].lstrip("-") in ("V", "version"):
        return "version", None, {}
    command, rest = arguments[0], list(arguments[1:])
    if command not in COMMANDS:
        allowed = f"{', '.join(COMMANDS)}{nearby(command, COMMANDS)}"
        raise InputError(f"command line: found {command!r}; allowed: {allowed}")
    options, operand = {}, None
    while rest:
        word = rest.pop(0)
        if word.startswith("-") and not is_number(word):
            if COMMANDS[command].options is None:
                _check_dash(word)
            value = rest.pop(0) if rest and (not rest[0].startswith("-") or is_number(rest[0])) else ""
            if word.lstrip("-") == "set" and COMMANDS[command].options is None:
                # PETSc keeps the last one only
                value = [*options.get("set", []), value]
            options[word.lstrip("-")] = value
        elif COMMANDS[command].many:
            operand = [*(operand or []), word]
        elif operand is None:
            operand = word
        else:
            raise InputError(f"command line: second operand: found {word!r}; allowed: pcontact {command} ONE [options]")
    if options.get("o") == "":
        raise InputError("command line: -o: found nothing; allowed: a directory (run), a file (convert, view)")
    asks, wanted = {"h", "help"} & set(options), COMMANDS[command].operand
    # with a scene the word is PETSc's
    if asks and (operand is None or COMMANDS[command].options is not None):
        return "help", command, {}
    if wanted and (operand is None or COMMANDS[command].many and len(operand) < 2):
        found = "no operand" if operand is None else f"{operand[0]} alone"
        raise InputError(f"command line: pcontact {command}: found {found}; allowed: {wanted}")
    if operand is not None and not wanted:
        raise InputError(f"command line: pcontact {command}: found {operand!r}; allowed: no operand")
    return command, operand, options


def _check_dash(word):
    """Refuse what PETSc, which reads the options of a run, takes for another one."""
    name, equals, value = word.lstrip("-").partition("=")
    if (word.startswith("--") or equals) and name in declared():
        raise InputError(f"command line: found {word!r}; allowed: -{name}{f' {value}' if equals else ''}")


def declared():
    """Names of the options of a run."""
    return {option.name for options in run_options().values() for option in options} | SET.keys()
