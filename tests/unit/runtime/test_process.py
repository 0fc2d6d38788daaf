"""Whether somebody may be looking at a stream."""

import os
import pty
import shutil
import subprocess
import sys

import pytest

from tests.support.commands import ROOT, environment

ASKED = "import sys; from pcontact.runtime.process import is_terminal; sys.stderr.write(str(is_terminal(sys.stdout)))"


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="there is no mpirun")
@pytest.mark.parametrize("terminal", [False, True])
def test_ranks_look_at_the_output_of_mpirun(tmp_path, terminal):
    """Open MPI gives ranks terminals, also where what they write goes to a file."""
    main, other = pty.openpty()
    with open(tmp_path / "log", "wb") as file:
        words = ["mpirun", "-n", "1", sys.executable, "-c", ASKED]
        done = subprocess.run(words, cwd=ROOT, env=environment(), stdin=subprocess.DEVNULL, stderr=subprocess.PIPE,
                              stdout=other if terminal else file, text=True, timeout=60)  # fmt: skip
    os.close(main)
    os.close(other)
    assert (done.returncode, done.stderr.split()[-1]) == (0, str(terminal)), done.stderr


@pytest.mark.parametrize("terminal", [False, True])
def test_without_ranks_the_stream_says_it(tmp_path, terminal):
    main, other = pty.openpty()
    with open(tmp_path / "log", "wb") as file:
        done = subprocess.run([sys.executable, "-c", ASKED], cwd=ROOT, env=environment(), stderr=subprocess.PIPE,
                              stdout=other if terminal else file, text=True, timeout=60)  # fmt: skip
    os.close(main)
    os.close(other)
    assert (done.returncode, done.stderr) == (0, str(terminal))
