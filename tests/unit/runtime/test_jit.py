"""Compiled kernels that are kept on disk."""

import importlib
import importlib.util
import pickle
import sys

import numba
import pytest

from pcontact.runtime import jit
from pcontact.runtime.jit import PACKAGE, _Uncached, sources

SOURCE = """
from pcontact.runtime.jit import njit

@njit
def twice(x):
    return 2.0 * x
"""


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
    found = set(sources(PACKAGE / "contact" / "search" / "nearest.py"))
    assert {"contact.search.walk", "contact.search.exclusion", "contact.surface.facet_maps", "runtime.jit"} <= found
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
        for function in (jit._file_of, jit._read, jit.sources):
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
        for function in (jit._file_of, jit._read, jit.sources):
            function.cache_clear()
