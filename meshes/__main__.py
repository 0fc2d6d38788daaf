"""`python -m meshes NAME -o FILE.msh [--h 0.05 ...]`: write one mesh; without a name, list the generators."""

from __future__ import annotations

import argparse
import ast
import inspect
import logging
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from . import GENERATORS


def _value(text: str) -> object:
    """A number, a tuple `4,3`, None, True, False, or else the text itself."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text


def _add_generator(commands: argparse._SubParsersAction, name: str, function: Callable[..., Path]) -> None:
    """A command with one option for every argument of the generator."""
    text = inspect.getdoc(function) or ""
    command = commands.add_parser(
        name,
        help=text.splitlines()[0].replace("%", "%%"),
        description=text.replace("%", "%%"),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument(
        "-o", "--output", type=Path, default=None, help=f"file to write (default {name}.msh)"
    )
    for key, parameter in list(inspect.signature(function).parameters.items())[1:]:
        command.add_argument(
            "--" + key.replace("_", "-"),
            dest=key,
            type=_value,
            default=parameter.default,
            metavar="VALUE",
            help=f"default {parameter.default}",
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 0 when the mesh is written, 2 when the input is wrong."""
    parser = argparse.ArgumentParser(
        prog="python -m meshes",
        description="Write the mesh of a case with a known answer.",
        epilog="several values: --n 4,3; options of one mesh: python -m meshes NAME --help",
    )
    commands = parser.add_subparsers(dest="name", metavar="NAME")
    for name, function in GENERATORS.items():
        _add_generator(commands, name, function)
    options = vars(parser.parse_args(arguments))
    name, output = options.pop("name"), options.pop("output", None)
    if name is None:
        parser.print_help()
        return 0
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        GENERATORS[name](output or Path(f"{name}.msh"), **options)
    except (ValueError, RuntimeError, OSError) as error:
        logging.getLogger(__name__).error("%s", error)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
