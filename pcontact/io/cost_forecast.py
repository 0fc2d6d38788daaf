"""What the pieces of a scene hold, and what others would add: for a user who has not decided yet."""

from pcontact.assembly.geometry import n_points
from pcontact.io.counters import Counters
from pcontact.runtime.jit import CALLS

MB = 1024.0**2
# seconds of a load step over those without the piece, ball on block (docs/performance.md)
FRICTION_TIMES, PLASTIC_TIMES = "0.8 to 1.6", "2.2 to 2.9"
# the same of finite strain (docs/finite_strain.md), and the bytes that contact which moves holds over those of contact
# that does not. From: blocks and ball on block, 1.9 to 2.4 times as many
FINITE_TIMES, MOVING = "1.5 to 2.3", 2.4


# what tables of bytes call the derivative of the normal traction
ROWS = "pairs.pairing.operator.rows"


def friction_bytes(d, rows):
    """Of a quadrature point: lag, slip reference and the jump before the step, d numbers each, and the derivative of
    d - 1 more components of the traction, ``rows`` bytes each."""
    return 3 * 8 * d + (d - 1) * rows


def plastic_bytes(d):
    """Of a quadrature point of the cells: plastic strain (6 components, 4 in the plane) and its accumulated norm."""
    return 8 * (7 if d == 3 else 5)


def cost_forecast(problem, scene):
    """Lines for the user. *Collective.*

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    scene : pcontact.scene.model.Scene

    Returns
    -------
    list of str
    """
    space = problem.space
    counts = Counters(space, problem.parts, CALLS)()
    lines = []
    for name, table in counts["bytes"].items():
        size, points = sum(table.values()), counts["points"].get(name)
        each = f", {size / points:.0f} bytes at each of {points} points" if points else ""
        lines.append(f"{name}: {size / MB:.3g} MB{each or f', {size / space.n_dofs:.0f} bytes per unknown'}")
    cells = space.comm.allreduce(sum(n_points(space, k) * len(table) for k, table in enumerate(space.cells)))
    contacts = [contact for contact in scene.contacts if not contact.tied]
    smooth = [contact.name for contact in contacts if not (contact.friction or contact.tresca or contact.law)]
    points = sum(counts["points"].get(name, 0) for name in smooth)
    if points:
        rows = sum(counts["bytes"].get(name, {}).get(ROWS, 0) for name in smooth) / points
        lines.append(_more("friction", points, friction_bytes(space.dim, rows), FRICTION_TIMES))
    if not scene.plastic:
        lines.append(_more("plasticity of all bodies", cells, plastic_bytes(space.dim), PLASTIC_TIMES))
    if not any(scene.finite(body) for body in scene.bodies):
        held = sum(sum(counts["bytes"].get(contact.name, {}).values()) for contact in contacts)
        lines.append(f"left out, finite strain of all bodies: up to {(MOVING - 1.0) * held / MB:.3g} MB for contact "
                     f"that moves, none for elastic bodies, a load step {FINITE_TIMES} times as long")  # fmt: skip
    biased = [contact.name for contact in contacts if contact.obstacle is None and not contact.unbiased
              and not contact.all and contact.source != contact.target]  # fmt: skip
    if biased:
        size = sum(sum(counts["bytes"][name].values()) for name in biased)
        lines.append(f"left out, unbiased contact: about {size / MB:.3g} MB, and twice the search and contact assembly")
    return lines


def _more(name, points, size, times):
    each = f"({size:.0f} bytes at each of {points} points)"
    return f"left out, {name}: {points * size / MB:.3g} MB for the state {each}, a load step {times} times as long"
