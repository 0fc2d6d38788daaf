"""Compiled kernels that are kept on disk."""

import importlib.util
import pickle

import numba
import pytest

from pcontact.runtime.jit import _Uncached

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
