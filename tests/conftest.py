"""How the tests run on several ranks: ``mpirun -n N python -m pytest``.

Every rank runs the same tests in the same order; those not marked `parallel` are left out, and those marked
`parallel(n)` where there are not n ranks. After each phase of a test (set-up, call, teardown) the ranks
compare notes: a test that fails on one rank is reported as failed by rank 0, the only one that prints. A
rank that failed while others are still inside the test (most likely waiting for it) ends them all.
"""

import os
import sys
import time
from pathlib import Path

# a worker of pytest-xdist inherits what MPI told its parent, and would take itself for that process
INHERITED = ("PMIX_", "PRTE_", "ORTE_", "OPAL_", "OMPI_COMM_", "OMPI_APP_", "OMPI_MCA_ess", "OMPI_MCA_orte",
             "OMPI_MCA_pmix")  # fmt: skip
if "PYTEST_XDIST_WORKER" in os.environ:
    for variable in [name for name in os.environ if name.startswith(INHERITED)]:
        del os.environ[variable]

# ranks that wait let others compute: three on two cores would wait for each other's time slices in every message
os.environ.setdefault("OMPI_MCA_mpi_yield_when_idle", "1")

import numpy as np  # noqa: E402
import pytest  # noqa: E402
from mpi4py import MPI  # noqa: E402

from pcontact.io.observers import Records  # noqa: E402
from pcontact.io.report import jsonable  # noqa: E402
from pcontact.io.report_schema import unknown  # noqa: E402
from pcontact.runtime.petsc import PETSc  # noqa: E402

# what support checks for several tests fails with the values in it, as in a test
pytest.register_assert_rewrite("tests.support")

WORLD = MPI.COMM_WORLD
PASSED, SKIPPED, FAILED = 0, 1, 2
OUTCOMES = {"passed": PASSED, "skipped": SKIPPED, "failed": FAILED}
# how long a failed rank waits for the others to leave the test, in seconds
PATIENCE = float(os.environ.get("PCONTACT_TEST_PATIENCE", 20.0))
# messages of the tests' own communicators cannot be mistaken for these
NOTES = WORLD.Dup() if WORLD.size > 1 else WORLD


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config):
    """Runs before the terminal reporter is made, which then keeps what it finds as standard output."""
    if WORLD.rank != 0:
        sys.stdout = open(os.devnull, "w")


def pytest_collection_modifyitems(config, items):
    if WORLD.size == 1:
        return
    out = [item for item in items if not _runs_here(item)]
    items[:] = [item for item in items if _runs_here(item)]
    config.hook.pytest_deselected(items=out)


def _runs_here(item):
    """Whether a test runs on this number of ranks; without numbers in its mark it runs on two and three, and on more
    if it is one of the pieces that a run is made of."""
    mark = item.get_closest_marker("parallel")
    if mark is None or mark.args:
        return mark is not None and WORLD.size in mark.args
    return WORLD.size < 4 or "unit" in item.path.parts


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport(item, call):
    report = yield
    if WORLD.size > 1:
        _compare(item, report)
    return report


def _compare(item, report):
    """Make the outcome the same on all ranks. Collective, unless it ends the run."""
    mine = OUTCOMES[report.outcome]
    flags = np.empty(NOTES.size, dtype=np.int64)
    request = NOTES.Iallgather(np.array([mine], dtype=np.int64), flags)
    end = time.monotonic() + PATIENCE
    while not request.Test():
        if mine == FAILED and time.monotonic() > end:
            _abort(item, report)
        time.sleep(1e-4)
    if np.all(flags == flags[0]) and mine != FAILED:
        return
    texts = NOTES.allgather(f"{report.outcome}\n{report.longreprtext}")
    report.outcome = "failed"
    report.longrepr = "\n".join(f"--- rank {rank}: {text}" for rank, text in enumerate(texts))


def _abort(item, report):
    capture = item.config.pluginmanager.getplugin("capturemanager")
    with capture.global_and_fixture_disabled():
        sys.stderr.write(f"{item.nodeid} failed on rank {WORLD.rank}, others wait in it: all ranks end\n"
                         f"{report.longreprtext}\n")
        sys.stderr.flush()
    WORLD.Abort(1)


@pytest.fixture(autouse=True)
def declared_names(monkeypatch):
    """Whatever a test runs, its report has no key that is not declared, and so not documented."""
    found, end = set(), Records._end

    def checked_end(self, converged, costs):
        end(self, converged, costs)
        found.update(unknown(jsonable(self.report.whole())))

    monkeypatch.setattr(Records, "_end", checked_end)
    yield
    assert not found, f"not in pcontact/io/report_schema.py: {sorted(found)}"


@pytest.fixture
def one_order():
    """Runs on all ranks repeat to the last digit: multigrid's Galerkin products add what other ranks send in one order.

    By default they add it in the order in which it comes, which from three ranks on differs from run to run.
    """
    if WORLD.size < 3:
        yield
        return
    PETSc.Options().setValue("matptap_via", "allatonce")
    yield
    PETSc.Options().delValue("matptap_via")


@pytest.fixture
def shared_tmp(tmp_path_factory):
    """A fresh directory, the same on all ranks. Collective."""
    path = str(tmp_path_factory.mktemp("shared")) if WORLD.rank == 0 else None
    return Path(WORLD.bcast(path))
