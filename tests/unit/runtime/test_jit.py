"""Compiled kernels that are kept on disk."""

import importlib
import importlib.util
import io
import os
import pickle
import re
import subprocess
import sys
import textwrap
import time
from types import SimpleNamespace

import numba
import pytest

from pcontact.runtime import jit, log
from pcontact.runtime.jit import PACKAGE, PARTS, _Uncached, sources

SOURCE = """
from pcontact.runtime.jit import njit

@njit
def twice(x):
    return 2.0 * x
"""


MEMORIES = jit._file_of, jit._read, jit.sources, jit._stamp


def imported(path):
    """A module anew, as a new process would have it."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("rest", [b"cpcontact.runtime.jit\nGone\n.", b"", b"\x80\x04 no pickle"])
def test_what_another_version_kept_is_compiled_anew(tmp_path, monkeypatch, rest):
    """An index that names a type which is no more, and files that were cut off."""
    monkeypatch.setattr(_Uncached, "reason", None)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    path = tmp_path / "kernels.py"
    path.write_text(SOURCE)
    assert imported(path).twice(1.5) == 3.0
    (index,) = (tmp_path / "cache").rglob("*.nbi")
    index.write_bytes(pickle.dumps(numba.__version__, protocol=-1) + rest)
    assert imported(path).twice(1.5) == 3.0
    again = imported(path)
    assert again.twice(1.5) == 3.0 and sum(again.twice.stats.cache_hits.values()) == 1


def test_sources_of_a_kernel():
    """What its module imports from, and what that does; nothing that has no part in kernels."""
    found = set(sources(PACKAGE / "contact" / "search" / "projection.py"))
    assert {"contact.search.facet", "contact.search.exclusion", "contact.surface.facet_maps", "runtime.jit"} <= found
    assert "runtime.log" not in found and "cli" not in found


def test_a_kernel_whose_callee_changes_is_compiled_anew(tmp_path, monkeypatch):
    """Also where the callee is two modules away; a kernel that calls nothing of it is kept."""
    package = tmp_path / "kernels"
    package.mkdir()
    decorated = "from pcontact.runtime.jit import njit\n{}\n@njit\ndef {}(x):\n    return {}\n"
    files = {
        "inner": decorated.format("", "inner", "2.0 * x"),
        "middle": decorated.format("from kernels.inner import inner\n", "middle", "1.0 + inner(x)"),
        "outer": decorated.format("from kernels.middle import (\n    middle,\n)\n", "outer", "middle(x)"),
        "other": decorated.format("", "other", "3.0 * x"),
        "__init__": "",
    }
    for name, text in files.items():
        (package / f"{name}.py").write_text(text)
    monkeypatch.setattr(jit, "PACKAGE", package)
    monkeypatch.setattr(_Uncached, "reason", None)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(str(tmp_path))

    def run():
        for name in [one for one in sys.modules if one.split(".")[0] == "kernels"]:
            del sys.modules[name]
        for function in MEMORIES:
            function.cache_clear()
        importlib.invalidate_caches()
        outer, other = (getattr(importlib.import_module(f"kernels.{name}"), name) for name in ("outer", "other"))
        values = outer(1.0), other(1.0)
        return values, [sum(kernel.stats.cache_hits.values()) for kernel in (outer, other)]

    try:
        assert run() == ((3.0, 3.0), [0, 0])
        assert run() == ((3.0, 3.0), [1, 1])
        # of another length: Python tells sources apart by seconds and length
        (package / "inner.py").write_text(files["inner"].replace("2.0 * x", "5.0 * x + 0.0"))
        assert run() == ((6.0, 3.0), [0, 1])
    finally:
        for function in MEMORIES:
            function.cache_clear()


CALLING = """
from pcontact.runtime.jit import njit, njit_inner

@njit_inner
def add(pair, x):
    return pair[0] + pair[1] * x

@njit
def sum_of(n, x):
    total = 0.0
    for i in range(n):
        total += add((i, 1), x) + add((0, 1), x) + add((2, i), x)
    return total
"""


@pytest.mark.skipif(not PARTS, reason="a version of numba that makes copies")
def test_constants_in_a_call_make_no_further_copies(tmp_path, monkeypatch):
    """A kernel that kernels call is compiled once for all values; Python can call it all the same."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    path = tmp_path / "calling.py"
    path.write_text(CALLING)
    module = imported(path)
    assert module.sum_of(3, 2.0) == 27.0
    assert len(module.add._part.overloads) == 1 and not module.add.overloads
    assert module.add((1, 2), 0.5) == 2.0
    # what kernels call is kept for those that are compiled later
    for index in (tmp_path / "cache").rglob("*sum_of*.nbi"):
        index.unlink()
    again = imported(path)
    assert again.sum_of(3, 2.0) == 27.0
    assert [sum(one.stats.cache_hits.values()) for one in (again.sum_of, again.add._part)] == [0, 1]


def test_another_copy_and_an_older_revision_find_what_is_compiled(tmp_path, monkeypatch):
    """What counts is what the source says, neither where it is nor when it was written."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))

    def hits(folder, text):
        (tmp_path / folder).mkdir(exist_ok=True)
        path = tmp_path / folder / "kernels.py"
        path.write_text(text)
        jit._stamp.cache_clear()
        kernel = imported(path).twice
        kernel(1.5)
        return sum(kernel.stats.cache_hits.values())

    assert hits("one", SOURCE) == 0
    assert hits("other", SOURCE) == 1
    assert hits("one", SOURCE.replace("2.0", "3.0")) == 0
    assert hits("one", SOURCE) == 1
    for number in range(jit.VERSIONS + 3):
        hits("one", SOURCE.replace("2.0", f"{number}.5"))
    assert len(list((tmp_path / "cache").iterdir())) == jit.VERSIONS


def test_a_run_that_compiles_says_so_once(tmp_path, monkeypatch, capsys):
    """Where the kernels go, and how long it took; a run that finds them says nothing."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(jit._State, "said", False)
    path = tmp_path / "calling.py"
    path.write_text(CALLING)
    before = jit.seconds()
    with log.of_a_library():
        imported(path).sum_of(3, 2.0)
    assert jit.seconds() > before
    told = capsys.readouterr()
    assert (told.out + told.err).count(f"they are kept in {tmp_path / 'cache'}") == 1
    before = jit.seconds()
    monkeypatch.setattr(jit._State, "said", False)
    imported(path).sum_of(3, 2.0)
    assert jit.seconds() == before and not any(capsys.readouterr())


@pytest.mark.parametrize("terminal", [True, False])
def test_signs_of_life_while_one_kernel_is_compiled(monkeypatch, terminal):
    """A line that changes on a terminal; in a file one more from time to time, and nothing that a terminal obeys."""
    stream = io.StringIO()
    stream.isatty = lambda: terminal
    state = SimpleNamespace(**{name: value for name, value in vars(jit._State).items() if name[0] != "_"})
    monkeypatch.setattr(jit, "_State", state)
    monkeypatch.setattr(jit, "ON_TERMINAL", 0.01)
    monkeypatch.setattr(log, "IN_FILE", 0.1)
    monkeypatch.setattr(jit, "resident", iter([5_000_000, 7_500_000]).__next__)
    state.seconds, state.kernels, state.bytes, state.said, state.told_at = 41.8, 6, 500_000, False, 41.8
    log.setup(0, stream)
    with jit.timed():
        jit.missed("folder")
        time.sleep(0.35)
    head, _, rest = stream.getvalue().partition("\n")
    assert head.endswith("kept in folder") and state.seconds >= 42.15 and state.teller is None
    assert jit.memory() == 3_000_000
    if terminal:
        shown = re.findall(r"\rcompiling kernels: (\d+ in \d+ s)", rest)
        assert shown[0] == "7 in 42 s" and len(shown) > 5
    else:
        assert set(rest.splitlines()) == {"compiling kernels: 7 in 42 s"} and 2 <= rest.count("\n") <= 3


def test_one_process_compiles_and_the_others_load(tmp_path):
    """Two processes that need the same kernel at the same time."""
    (tmp_path / "kernels.py").write_text(SOURCE)
    code = textwrap.dedent(
        """
        import time
        from kernels import twice
        from pcontact.runtime import log
        log.setup()
        compile_core = twice._compiler.compile
        def slowly(*arguments):
            time.sleep(1.0)
            return compile_core(*arguments)
        twice._compiler.compile = slowly
        print("ready", flush=True)
        input()
        twice(1.5)
        print("hits", sum(twice.stats.cache_hits.values()))
        """
    )
    path = f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    runs = [subprocess.Popen([sys.executable, "-c", code], env=environment, stdin=subprocess.PIPE,
                             stdout=subprocess.PIPE, text=True) for _ in range(2)]  # fmt: skip
    for run in runs:
        assert run.stdout.readline() == "ready\n"
    for run in runs:
        run.stdin.write("\n")
        run.stdin.flush()
    said = [run.communicate()[0] for run in runs]
    assert sorted(text.split("hits ")[1].strip() for text in said) == ["0", "1"]
