"""What cases with known answers share: runs of scenes, their records by time, tables of expected and found numbers.

A maker is a function of the parsed arguments and of options of PETSc that runs the scenes of one case and returns
:class:`Found`. *Collective.*
"""

from typing import NamedTuple

import numpy as np

from drivers._common import log, make_parser, print_table, running, write_json
from pcontact.runtime.observer import Observer


class Found(NamedTuple):
    """What a maker returns.

    Attributes
    ----------
    rows : list of (str, float, float)
        What it is, expected, found; an expected NaN: there is no number.
    records : list of dict
        Of the load steps of all runs.
    converged : bool
        Whether all of them did.
    norms : list of float
        Of the residual, in the last solve of the last run.
    """

    rows: list
    records: list
    converged: bool
    norms: list


class Rows(Observer):
    """Keeps the records of the load steps, with their times."""

    def __init__(self):
        self.records = []

    def step(self, step, u, record):
        self.records.append({**record, "time": step.time})


def solve(args, name, scene):
    """The records of a run, whether it converged, and the last norms of the residual. *Collective.*"""
    rows = Rows()
    with running(scene, args.o / name, [rows]) as (simulation, converged):
        norms = list(simulation.newton.norms)
    return rows.records, converged, norms


def at(records, time):
    """The record that is nearest to a time."""
    return min(records, key=lambda record: abs(record["time"] - time))


def tail(norms):
    """The last four norms of the residual over the first one."""
    return "  ".join(f"{norm / norms[0]:.1e}" for norm in norms[-4:]) if norms else "-"


def effort(records, norms):
    """Log Newton's iterations per load step, the load steps that were cut, and the last residuals."""
    counts = [record["newton"] for record in records]
    cuts = sum(record["cutbacks"] for record in records)
    log.info("  Newton %.2f a load step, at most %d; %d cut; last residuals %s", np.mean(counts), max(counts), cuts,
             tail(norms))  # fmt: skip
    return {"newton": counts, "cuts": cuts, "residuals": norms}


def off(rows):
    """The largest relative difference of found from expected numbers, of those that there are."""
    return max((abs(found / expected - 1.0) for _, expected, found in rows if np.isfinite(expected)), default=0.0)


def compare(args, makers, bounds, name, petsc):
    """Run the cases of the command line; 1 where one does not converge or misses a known answer. *Collective.*

    Parameters
    ----------
    args : argparse.Namespace
    makers : dict of str to callable
        By case.
    bounds : dict of str to float
        How far a found number may be from the expected one, by case; not of tiny runs.
    name : str
        Of the JSON file.
    petsc : dict of str to str
    """
    status, results = 0, {}
    for case in args.case:
        rows, records, converged, norms = makers[case](args, petsc)
        table = [(*row, 100.0 * (row[2] / row[1] - 1.0)) for row in rows]
        print_table(case, ["", "expected", "found", "off [%]"], table)
        results[case] = {"rows": rows, **effort(records, norms)}
        worst = off(rows)
        if not converged or (worst > bounds[case] and not args.tiny):
            log.error_line(f"{case}: {100.0 * worst:.3g} % off" if converged else f"{case}: not converged")
            status = 1
        write_json(args.o / f"{name}.json", results)
    return status


def case_parser(description, name, cases, n=None):
    """Parser of a driver with cases: which ones, how fine (with n = "+" several), fields or not."""
    parser = make_parser(description, f"{name}_results")
    parser.add_argument("--case", nargs="+", choices=cases, default=list(cases), help="which ones (default: all)")
    text = "cells along a side (default: by case, or several)"
    parser.add_argument("--n", type=int, nargs=n, default=None, help=text)
    parser.add_argument("--fields", action="store_true", help="write fields for ParaView")
    return parser
