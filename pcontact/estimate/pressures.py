"""The pressure of a contact: at the points of its sources, its norm in L2, and how far two of them are apart.

That the norms of two pressures hardly differ says little of how far they are apart: what waves along a contact leaves
the norm as it is.
"""

from typing import NamedTuple

import numpy as np

from pcontact.runtime.petsc import MPI


class SourcePressure(NamedTuple):
    """On the source of a pair.

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
    """The pressure of a contact: a list of :class:`SourcePressure`, of its pairs. *Collective.*

    Parameters
    ----------
    contact : pcontact.contact.report.ContactReport
    u : PETSc.Vec
    """
    return [SourcePressure(state["x"], state["weight"], state["pressure"]) for state in contact.states(u)]


def named(problem, name, u):
    """That of the contact of a name. *Collective.*"""
    return of_contact(next(one for one in problem.contacts if one.name == name), u)


def norm(comm, pressures):
    """Norm in L2 of a list of :class:`SourcePressure`. *Collective.*"""
    own = sum(float(one.weight @ one.value**2) for one in pressures)
    return float(np.sqrt(comm.allreduce(own, op=MPI.SUM)))


def apart(comm, one, other):
    """Distance of two pressures in L2; nan where their points are not the same. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    one, other : list of SourcePressure
    """
    total, same = 0.0, True
    for a, b in zip(one, other, strict=True):
        same &= a.x.shape == b.x.shape and np.allclose(a.x, b.x, rtol=1e-9, atol=0.0)
        total += float(a.weight @ (a.value - b.value) ** 2) if same else 0.0
    if not comm.allreduce(bool(same), op=MPI.LAND):
        return float("nan")
    return float(np.sqrt(comm.allreduce(total, op=MPI.SUM)))
