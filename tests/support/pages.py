"""Pages whose blocks a reader copies and pastes: run in the order in which they stand, in a folder.

| block | |
|---|---|
| its first line is a comment with the name of a file | written to that file |
| ``sh`` | commands, run |
| ``python`` | run; all of a page share their names, as in a notebook |
| ``bash`` | what needs a cluster: its syntax is checked |
| others | to read |

Commands of pcontact and of the repository run in this process, which saves the start of Python: a page is then a
matter of seconds.

    python -m tests.support.pages PAGE DIR       runs a page as it stands, in DIR
"""

import contextlib
import os
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

from meshes.__main__ import main as write_mesh
from pcontact.cli import main
from pcontact.runtime.petsc import PETSc
from pcontact.usage import parse
from tests.support.commands import environment

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
FILE = re.compile(r"(?:#|\*\*|//) ([\w-]+\.(?:toml|inp|py|geo))\n")
SPECIAL = re.compile(r"[|&;<>$`]")


def blocks(page):
    """Kind and text of the blocks of a page."""
    return BLOCK.findall(Path(page).read_text(encoding="utf-8"))


def run_page(page, folder, instead=()):
    """Run all blocks of a page.

    Parameters
    ----------
    page : pathlib.Path
    folder : pathlib.Path
        Is made the working directory.
    instead : sequence of (str, str)
        What takes the place of what in the blocks, such as coarser meshes; each must be there.
    """
    names, found = {"__name__": "__main__"}, blocks(page)
    for old, new in instead:
        assert any(old in text for _, text in found), f"{page.name}: {old!r} is in no block"
        found = [(kind, text.replace(old, new)) for kind, text in found]
    with contextlib.chdir(folder):
        for kind, text in found:
            if name := FILE.match(text):
                Path(name[1]).write_text(text, encoding="utf-8")
            elif kind == "bash":
                subprocess.run(["bash", "-n", "-c", text], check=True)
            elif kind == "python":
                exec(compile(text, f"{page.name}, block", "exec"), names)
            elif kind == "sh":
                for words in _commands(text):
                    _execute(words)


def _commands(text):
    """The words of each command."""
    lines = re.sub(r"\\\n", " ", text).splitlines()
    for line in lines:
        words = shlex.split(line, comments=True)
        if words:
            yield [line] if SPECIAL.search(shlex.join(words).replace("'", "")) else words


def _execute(words):
    """One command; one that fails is an error."""
    known = {"pcontact": _pcontact, "python": _python}.get(words[0])
    if known is not None:
        status = known(words[1:])
        assert not status, f"{shlex.join(words)}: exit status {status}"
        return
    line = re.sub(r"\bpcontact ", f"{sys.executable} -m pcontact ", words[0] if len(words) == 1 else shlex.join(words))
    done = subprocess.run(["bash", "-e", "-c", line], capture_output=True, text=True, env=environment(), timeout=300)
    assert done.returncode == 0, f"{line}: {done.stdout}{done.stderr}"


def _pcontact(words):
    """A command of the program, with its options in PETSc's database, as those of a process are."""
    database, before = PETSc.Options(), PETSc.Options().getAll()
    for name, value in parse(words)[2].items():
        database.setValue(name, value or "true")
    try:
        return _status(main, words)
    finally:
        for name in set(database.getAll()) - set(before):
            database.delValue(name)


def _python(words):
    """A generator of meshes, a script of the repository, or one that the page has written."""
    if words[:2] == ["-m", "meshes"]:
        return write_mesh(words[2:])
    before, sys.argv = sys.argv, words[1:] if words[0] == "-m" else words
    try:
        if words[0] == "-m":
            return _status(lambda: runpy.run_module(words[1], run_name="__main__"))
        return _status(lambda: runpy.run_path(words[0], run_name="__main__"))
    finally:
        sys.argv = before


def _status(function, *args):
    try:
        function(*args)
    except SystemExit as end:
        return end.code
    return 0


if __name__ == "__main__":
    os.makedirs(sys.argv[2], exist_ok=True)
    run_page(Path(sys.argv[1]).resolve(), Path(sys.argv[2]))
