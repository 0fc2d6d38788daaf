"""The first page that a new user copies from does what it says."""

import re
import subprocess
import sys

import pytest

from tests.support.commands import ROOT, environment


@pytest.mark.slow
def test_every_block_works_by_copy_and_paste(tmp_path):
    pytest.importorskip("pyvista")
    text = (ROOT / "docs" / "quick.md").read_text()
    blocks = re.findall(r"```(sh|python)\n(.*?)```", text, re.DOTALL)
    assert [kind for kind, _ in blocks] == ["sh", "sh", "python"]
    said = []
    for kind, code in blocks:
        code = code.replace("pcontact ", f"{sys.executable} -m pcontact ") if kind == "sh" else code
        command = ["bash", "-e", "-c", code] if kind == "sh" else [sys.executable, "-c", code]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=environment(), timeout=300)
        assert done.returncode == 0, done.stdout + done.stderr
        said.append(done.stdout)
    for name in ("pressure.png", "force.png", "pressed.gif", "pressed.html", "stress.png"):
        assert (tmp_path / "first" / name).stat().st_size > 1000
    forces = [float(line.split()[-1]) for line in said[-1].splitlines() if line.startswith("coefficient")]
    assert len(forces) == 4 and abs(forces[0]) < 1e-3 * forces[1] and forces == sorted(forces)
    assert re.search(r"times 1169", text) and "-1169" in said[0]
