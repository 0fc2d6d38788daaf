"""When writing fails: one line, exit status 3, the same on every rank, and nothing lost that was written before."""

import pytest

from pcontact.cli import guarded
from pcontact.runtime.errors import InputError, OutputError
from pcontact.runtime.parallel import agree, on_root, together
from pcontact.runtime.petsc import MPI

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel


def stops(error):
    """Raise an error, if there is one."""
    if error is not None:
        raise error


@parallel
def test_every_rank_learns_of_an_error_of_output(capfd):
    """Whichever rank fails; the error keeps its kind, and ends the program with status 3."""
    failing = WORLD.size - 1
    mine = OutputError("x: full") if WORLD.rank == failing else None
    for call in (lambda: together(WORLD, stops, mine), lambda: agree(WORLD, mine)):
        with pytest.raises(OutputError, match="x: full"):
            call()
        assert guarded(call) == 3
    with pytest.raises(OutputError, match="x: full"):
        on_root(WORLD, stops, OutputError("x: full"))
    with pytest.raises(InputError, match="wrong"):
        agree(WORLD, "wrong" if WORLD.rank == failing else None)
    lines = capfd.readouterr().err.splitlines()
    assert lines == (["pcontact: error: x: full"] * 2 if WORLD.rank == 0 else [])
