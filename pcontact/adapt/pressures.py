"""How far the pressures of a contact are apart in L2, in two solutions on one mesh.

That their norms hardly differ says little: what waves along a contact leaves the norm as it is.
"""

from typing import NamedTuple

import numpy as np

from pcontact.runtime.petsc import MPI


class Pressure(NamedTuple):
    """Of the source of a pair.

    Attributes
    ----------
    x : ndarray (np, d)
        Reference positions of its points [length].
    weight, value : ndarray (np,)
        Area of the points, times the weight of the pair, and pressure [stress].
    """

    x: np.ndarray
    weight: np.ndarray
    value: np.ndarray


def of_contact(contact, u):
    """The pressure of a contact: a list of :class:`Pressure`, of its pairs. *Collective.*

    Parameters
    ----------
    contact : pcontact.contact.report.ContactReport
    u : PETSc.Vec
    """
    return [Pressure(state["x"], state["weight"], state["pressure"]) for state in contact.states(u)]


def found(problem, name, u):
    """That of the contact of a name. *Collective.*"""
    return of_contact(next(one for one in problem.contacts if one.name == name), u)


def apart(comm, one, other):
    """Distance of two pressures in L2; nan where their points are not the same. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    one, other : list of Pressure
    """
    total, same = 0.0, True
    for a, b in zip(one, other, strict=True):
        same &= a.x.shape == b.x.shape and np.allclose(a.x, b.x, rtol=1e-9, atol=0.0)
        total += float(a.weight @ (a.value - b.value) ** 2) if same else 0.0
    if not comm.allreduce(bool(same), op=MPI.LAND):
        return float("nan")
    return float(np.sqrt(comm.allreduce(total, op=MPI.SUM)))


def change(simulation, other, name):
    """How far the pressure of another run is from that of a simulation on the same mesh. *Collective.*

    Where the points of the contact are others, the pressures are those that the contact of the simulation has with both
    displacements.

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
    other : pcontact.adapt.variants.Answer
    name : str
        Of the contact.
    """
    problem, u = simulation.problem, simulation.stepper.u
    own = found(problem, name, u)
    distance = apart(simulation.comm, own, other.pressure)
    if np.isfinite(distance):
        return distance
    moved = u.copy()
    moved.setArray(other.u)
    return apart(simulation.comm, own, found(problem, name, moved))
