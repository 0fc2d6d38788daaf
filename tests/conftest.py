"""How the tests run on several ranks: ``mpirun -n N python -m pytest``.

Every rank runs the same tests in the same order; those not marked `parallel` are left out, and those
marked `parallel(n)` where there are not n ranks. With `--spread` each test runs on one of its numbers of
ranks only. After each phase of a test (set-up, call, teardown) the ranks compare notes: a test that fails
on one rank is reported as failed by rank 0, the only one that prints. A rank that failed while others are
still inside the test (most likely waiting for it) ends them all.
"""

import os
import sys
import time
import zlib
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
STATUS = pytest.StashKey()
# messages of the tests' own communicators cannot be mistaken for these
NOTES = WORLD.Dup() if WORLD.size > 1 else WORLD


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config):
    """Runs before the terminal reporter is made, which then keeps what it finds as standard output."""
    if WORLD.rank != 0:
        sys.stdout = open(os.devnull, "w")


def pytest_addoption(parser):
    parser.addoption("--spread", action="store_true", help="run each test on one of its numbers of ranks only")


def pytest_ignore_collect(collection_path):
    """On several ranks nothing is imported where no test is for them."""
    if WORLD.size > 1 and collection_path.suffix == ".py" and "mark.parallel" not in collection_path.read_text():
        return True
    return None


def pytest_collection_modifyitems(config, items):
    spread = config.getoption("spread")
    here = [item for item in items if WORLD.size in _numbers(item, spread)]
    config.hook.pytest_deselected(items=[item for item in items if item not in set(here)])
    items[:] = here


def _numbers(item, spread):
    """Numbers of ranks on which a test runs: one, if it is not marked, and those of its mark. Without numbers in it
    these are two and three, and four for tests of the pieces that a run is made of. To `spread` is to take one of them,
    by a checksum of the test's name, two ranks more often than three where whole runs take their time."""
    mark, unit = item.get_closest_marker("parallel"), "unit" in item.path.parts
    if mark is None:
        return (1,)
    numbers = mark.args or ((1, 2, 3, 4) if unit else (1, 2, 3))
    if not spread:
        return (1, *numbers)
    several = numbers if unit or mark.args else (1, 2, 2, 3)
    return (several[zlib.crc32(item.nodeid.encode()) % len(several)],)


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


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session, exitstatus):
    """Keep the status of the session."""
    session.config.stash[STATUS] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    """End, on several ranks, without PETSc's last collective clean-up: where tests have raised exceptions ranks may
    hold other objects than the others, and would wait for them for ever."""
    if WORLD.size > 1 and STATUS in config.stash:
        sys.stdout.flush()
        sys.stderr.flush()
        MPI.Finalize()
        os._exit(config.stash[STATUS])


@pytest.fixture(autouse=True)
def declared_names(monkeypatch):
    """Whatever a test runs, its report has no key that is not declared, and so not documented."""
    found, write = set(), Records._write

    def checked_write(self, entries):
        write(self, entries)
        if "converged" in entries:
            found.update(unknown(jsonable(self.report.whole())))

    monkeypatch.setattr(Records, "_write", checked_write)
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
