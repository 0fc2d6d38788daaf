"""The last lines of a run: what came out, what it took, where it is. And the same as lines for programs."""

import json
import math
import sys

from pcontact.io.report import jsonable
from pcontact.runtime import log, process
from pcontact.runtime.observer import Observer

# part of the normal force below which friction is not shown
NEGLIGIBLE = 1e-6
# facets across a contact area from which on its largest pressure is resolved. From: Hertz' pressure of cylinders and of
# a ball on a block, degree 1 and 2 (docs/tables/accuracy.md).
ACROSS = 6


def summary(report, directory):
    """Lines about a run that has ended.

    Parameters
    ----------
    report : dict
        As in ``report.json``; its `steps` may be an iterator.
    directory : str or Path
        Where the results are.

    Returns
    -------
    list of str
    """
    count, last, most, at = 0, None, {}, {}
    for last in report["steps"]:
        count += 1
        for name, contact in last.get("contacts", {}).items():
            pressure = contact.get("max_pressure") or 0.0
            if pressure > most.get(name, -1.0):
                most[name], at[name] = pressure, contact
    if last is None:
        return [f"no load step converged; the report is in {directory}"]
    seconds = report["timing"].get("total")
    took = f" in {seconds:.1f} s" if isinstance(seconds, float) else ""
    compiled = report["timing"].get("compile") or 0.0
    once = bool(took and compiled >= 0.1)
    took += f" ({compiled:.1f} s of it compiled kernels, once)" if once else ""
    memory = f", {_peak(report):.0f} MB on the largest rank" if _peak(report) else ""
    memory += f" ({report['timing'].get('kernels_mb') or 0.0:.0f} MB of it for kernels)" if memory and once else ""
    word = log.coloured("done", "green") if report["converged"] else log.coloured("ended early", "yellow")
    lines = [f"{word}: {count} load steps to time {last['time']:g}{took}{memory}"]
    for name, contact in last.get("contacts", {}).items():
        force = "force " + " ".join(f"{_number(value):.5g}" for value in contact["force"])
        if "radial_sum" in contact:
            force = (f"axial force {_number(contact['axial_force']):.5g} of the whole circumference, radial sum "
                     f"{_number(contact['radial_sum']):.5g}")  # fmt: skip
        if contact.get("normal_force") and "radial_sum" not in contact:
            force += _parts(contact)
        lines.append(f"  {name}: {force}, largest pressure {_number(contact['max_pressure']):.5g} (of all load steps "
                     f"{most[name]:.5g}), penetration {_number(contact['max_penetration']):.3g}")  # fmt: skip
    if "target" not in report.get("accuracy", {}):
        lines += _unresolved(at)
    lines += _largest(last.get("largest", {}))
    if report["warnings"]:
        lines.append(f"  {len(report['warnings'])} warnings, above and in report.json")
    lines.append(f"  results in {directory}; pictures: pcontact view {directory}")
    return lines


def _parts(contact):
    """Magnitudes of the normal force and of friction, and the centre, in brackets; nothing without contact."""
    if None in contact["centre"] or any(map(math.isnan, contact["centre"])):
        return ""
    normal, friction = (math.hypot(*contact[key]) for key in ("normal_force", "friction_force"))
    slides = f", friction {friction:.5g}" if friction > NEGLIGIBLE * normal else ""
    return f" (normal {normal:.5g}{slides}, at {' '.join(f'{_number(x):.4g}' for x in contact['centre'])})"


def _unresolved(contacts):
    """Lines on contacts, each at its largest pressure, of which few facets are closed and others are not."""
    lines = []
    for name, contact in contacts.items():
        count, space = contact.get("facets") or 0, len(contact["force"]) == 3
        across = math.sqrt(count) if space else count
        if 0 < across < ACROSS and contact["open"]:
            lines.append(
                f"  {name}: the contact area is about {across:.0f} facet{'s' * (across >= 1.5)} across: its largest "
                f"pressure is not resolved; remedy: {ACROSS} or more there, or -error 5% -error_of pressure:{name}"
            )
    return lines


_WORDS = {"equivalent_stress": "equivalent stress", "equivalent_plastic_strain": "equivalent plastic strain",
          "displacement": "displacement"}  # fmt: skip


def _largest(found):
    """Line of the largest stress, plastic strain and displacement of a load step; none without any."""
    parts = []
    for name, words in _WORDS.items():
        one = found.get(name)
        if one is not None and one["place"] is not None:
            at = ", ".join(f"{_number(x):.4g}" for x in one["place"])
            parts.append(f"{words} {_number(one['value']):.5g} in {one['body']} at ({at})")
    return [f"  largest {'; '.join(parts)}"] * bool(parts)


def _number(value):
    """A number without a negative zero; what is not finite is null in JSON."""
    return math.nan if value is None else value + 0.0


def _peak(report):
    """The largest peak of a rank [MB], 0 if it is not known."""
    marks = report.get("memory", {}).values()
    return max((mark.get("peak_mb_largest") or 0.0 for mark in marks if isinstance(mark, dict)), default=0.0)


class JsonLines(Observer):
    """Observer that says every load step, cut and the end as a line of JSON on standard output. Rank 0 speaks.

    Parameters
    ----------
    speaks : bool
    """

    def __init__(self, speaks):
        self._speaks = speaks

    def _say(self, event, **values):
        if self._speaks:
            process.put(sys.stdout, json.dumps(jsonable({"event": event, **values})) + "\n")

    def step(self, step, u, record):
        """A load step that has been committed, as in ``report.json``."""
        self._say("step", number=step.number, **record)

    def cut(self, target, result):
        """A load step that is cut back."""
        self._say("cut", time=target, reason=result.reason, newton=result.newton, residual=result.residual)

    def end(self, converged):
        """The end."""
        self._say("end", converged=converged, warnings=log.warnings())


class PassLines(JsonLines):
    """The same of runs on one mesh after the other, until an error is reached: a line for every pass, too, and one end
    for all."""

    def end(self, converged):
        """That of a pass is not the end."""

    def passed(self, done):
        """A :class:`pcontact.adapt.passes.Pass`, as in ``report.json``."""
        self._say("pass", **done.report())

    def ended(self, converged, reached):
        """The end."""
        self._say("end", converged=converged, reached=reached, warnings=log.warnings())
