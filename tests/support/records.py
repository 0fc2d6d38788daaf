"""Records of load steps."""

import numpy as np

from pcontact.runtime.observer import Observer


class Log(Observer):
    """Observer that keeps the records."""

    def __init__(self):
        self.records, self.cuts, self.verdict = [], [], None

    def step(self, step, u, record):
        self.records.append(record)

    def cut(self, target, outcome):
        self.cuts.append(target)

    def end(self, converged):
        self.verdict = converged


def step_row(time, force=1.0):
    """A record with numbers of all kinds."""
    return {
        "time": time, "newton": np.int64(5), "krylov": 61, "cutbacks": 0,
        "reactions": {"base": np.array([0.0, 0.0, force])},
        "contacts": {"pair": {"force": [0.0, 0.0, -force], "area": np.float64(0.1), "open": 3}},
        "probes": {"tip": {"mean": [0.0, 0.5]}}, "plastic": {"yielded_volume": float("nan")},
    }  # fmt: skip
