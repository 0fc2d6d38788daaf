"""What it takes to compile the kernels that scenes need, function by function, from an empty cache.

    python scripts/bench_compile.py drivers/examples/*.toml [--rows 30]

The meshes must be there. Seconds are of the processor; those of a function are without the functions that it calls.
Scenes run one after the other in one process: what the first one has compiled costs the next one nothing.
"""

import argparse
import os
import tempfile
import time as clock
from collections import defaultdict

CACHE = tempfile.TemporaryDirectory()
# kernels ask for their place where they are declared
os.environ["NUMBA_CACHE_DIR"] = CACHE.name

from numba.core import event  # noqa: E402

from pcontact.runtime import log  # noqa: E402
from pcontact.scene.reader import read_scene  # noqa: E402
from pcontact.simulation import Simulation  # noqa: E402


class Compilation(event.Listener):
    """Seconds (a list, one for each copy) by function."""

    def __init__(self):
        self.seconds, self._open = defaultdict(list), []

    def on_start(self, event):
        """A function begins, within the one that calls it."""
        self._open.append([clock.process_time(), 0.0])

    def on_end(self, event):
        """It ends."""
        start, inner = self._open.pop()
        took, function = clock.process_time() - start, event.data["dispatcher"].py_func
        self.seconds[f"{function.__module__}.{function.__qualname__}"].append(took - inner)
        if self._open:
            self._open[-1][1] += took

    def total(self):
        """Sum over the functions so far [s]."""
        return sum(map(sum, self.seconds.values()))


def main():
    """Run the scenes and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--rows", type=int, default=30)
    args, found = parser.parse_args(), Compilation()
    event.register("numba:compile", found)
    log.setup(level="error")
    for scene in args.scenes:
        before, start = found.total(), clock.process_time()
        simulation = Simulation(read_scene(scene))
        simulation.run()
        simulation.free()
        took, compiled = clock.process_time() - start, found.total() - before
        print(f"{scene}: {took:.1f} s, compilation {compiled:.1f} s", flush=True)
    copies = sum(map(len, found.seconds.values()))
    print(f"compilation {found.total():.1f} s, {copies} copies of {len(found.seconds)} functions")
    for name, seconds in sorted(found.seconds.items(), key=lambda row: -sum(row[1]))[: args.rows]:
        print(f"{sum(seconds):7.2f} s  {len(seconds):3d}  {name}")


if __name__ == "__main__":
    main()
