"""The contract between the discrete problem and its parts: bulk, contact pairs, and whatever else is added to them.

`Problem`, `Newton`, the stepper and the writers call the methods of :class:`Item` and nothing else. All of them have a
default that says nothing, so that a new item writes those that it has an answer to. Displacements are PETSc vectors,
results on owned nodes numpy arrays (n_owned, d).
"""

from dataclasses import dataclass

import numpy as np

from pcontact.runtime import log


@dataclass(frozen=True, eq=False)
class StatusRule:
    """By what the points of a contact pair are open, stick or slip: an argument of residual and tangent.

    Attributes
    ----------
    stick : bool
        Closed points stick, whatever the law of friction says.
    frozen : bool
        Points that were closed at the end of the last load step are closed, and stick; all others are open.
    opened : ndarray (np,) of bool, optional
        Points that stay open, see :meth:`ActiveSet.recede`.
    closed : ndarray (np,) of bool, optional
        Points that are closed, whatever their traction; all others are open.
    """

    stick: bool = False
    frozen: bool = False
    opened: np.ndarray | None = None
    closed: np.ndarray | None = None


LAW, FROZEN = StatusRule(), StatusRule(stick=True, frozen=True)


class ActiveSet:
    """The points of an item that open and close, as far as Newton's method and the stepper ask for them."""

    def step_limit(self, u, y, falls=None):
        """Part of the Newton step ``-y`` from ``u`` to take; None for no say. *Collective.*

        `falls` (n_components,) of bool says which bodies nothing but the stabilisation holds back; None: not known.
        """
        return None

    def turned(self, u):
        """Changes by ``u`` at the points of this rank (4,): area closed in the last tangent, area of that open in
        ``u``, area closed in ``u`` alone [length^(d - 1)], number of the points that open; infinite where the pressure
        does not say what is open. *Collective.*
        """
        return np.zeros(4)

    def recede(self, u, rule):
        """The rule under which points that are open in the last tangent or in ``u`` stay so; None if none is left that
        is closed. *Collective.*
        """
        return rule

    def closed_count(self):
        """Points of this rank that were closed at the end of the last load step."""
        return 0

    def area_changed_by_supports(self, before, u):
        """Area of the points of this rank that ``u``, in which only supports have moved, opens or closes.
        *Collective.*
        """
        return 0.0

    def closed_area(self):
        """Area of the points of this rank that were closed in the last tangent [length^(d - 1)]."""
        return 0.0

    def active_nodes(self):
        """Owned nodes (n,), global numbers, of the points that were closed in the last tangent. *Collective.*"""
        return np.zeros(0, dtype=np.int64)

    def clearance(self, u, fields, beyond=False):
        """Distances of points from contact, and what motions of whole bodies would change in them. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
        fields : list of PETSc.Vec
            Displacements of m motions of every body at once.
        beyond : bool
            Whether distances count from where the law bears nothing any more.

        Returns
        -------
        distance : ndarray (n,)
            Of the points of this rank that have a partner other than their own body: by so much the gap has to shrink
            until they are closed [length].
        bodies : ndarray (n, 2)
            Components of points and partners; -1 for an obstacle.
        rows : ndarray (n, 2, m)
            What the motions of the two bodies add to the distance.
        """
        return np.zeros(0), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2, len(fields)))

    def force_magnitudes(self, u):
        """Sums (n_components,) of the magnitudes of the contact forces at the points of this rank on every connected
        component [force]. *Collective.*
        """
        return 0.0

    def bonds(self):
        """Forces that adhesion at the points of this rank may exert on every connected component without pressure
        (n_components,) [force]. *Collective.*
        """
        return 0.0

    def closed_areas(self):
        """Area (n_components,) of the points of this rank that were closed at the end of the last load step, by
        component. *Collective.*
        """
        return 0.0


def active_set(item):
    """The :class:`ActiveSet` of an item, or None; of one that answers for itself, as items once did, with a warning."""
    asked = {name: getattr(item, name) for name in vars(ActiveSet) if not name.startswith("_") and hasattr(item, name)}
    if not asked:
        return item.active
    log.warning("item %s: %s: methods of items; remedy: an ActiveSet as its attribute active has them now", item.name,
                ", ".join(asked))  # fmt: skip
    own = ActiveSet()
    vars(own).update(asked)
    return own


class Item:
    """A part of the discrete problem. Residual and tangent are functions of displacement, committed state and rule.

    Attributes
    ----------
    name : str
        For reports and checkpoints.
    space : pcontact.space.space.Space
    changes : bool
        Whether the tangent depends on the displacement, or the pattern on the load step.
    version : int
        Grows when the pattern changes.
    can_slip : bool
        Whether points that are closed may slip.
    rigid : bool
        Whether the forces of the item come from outside the bodies: contact with an obstacle.
    floats : bool
        Whether it acts on a body that supports leave free.
    holds : bool
        Whether it resists every motion of every body, so that no step is without a size.
    stiff : bool
        Whether multigrid alone fares badly with its tangent.
    symmetric : bool
        Whether the tangent is symmetric.
    radius : float
        How far its bodies may move against each other in a load step [length].
    flips : list of int
        Points of this rank whose status changed in each tangent of the load step.
    too_deep : int
        Points of this rank deeper in an obstacle than the radius.
    verifies : bool
        Whether :meth:`renew` is to be asked at the solution of a load step.
    follows : bool
        Whether that is what a load step is about, and no check that may be left out.
    stale : float
        What :meth:`renew` said last: the part by which the answer would be wrong with what the load step kept.
    lasts : float
        So far bodies may move before :meth:`renew` might say anything else than it did last [length].
    active : ActiveSet or None
        Of contact: its points that open and close.
    """

    name = "bodies"
    space = None
    changes = True
    version = 0
    can_slip = rigid = floats = holds = stiff = verifies = follows = False
    symmetric = True
    radius = np.inf
    flips = ()
    too_deep, stale, lasts, active = 0, 0.0, 0.0, None

    # -- what every item has --------------------------------------------------------------------------------------

    def pattern(self):
        """Owned block rows: rowptr (n_owned + 1,), columns (nnz,) of global nodes, sorted in each row."""
        raise NotImplementedError

    def residual(self, u, out, rule=LAW):
        """Add the forces on the owned nodes to ``out`` (n_owned, d) [force]. *Collective.*"""
        raise NotImplementedError

    def external(self, u, out):
        """Add those of its forces that come from outside the bodies to ``out`` (n_owned, d) [force]: loads, which
        :meth:`residual` has with the other sign. Contact with obstacles says so itself, see `rigid`. *Collective.*
        """

    def drag(self, u, out):
        """Add those that come from outside and are no loads to ``out`` (n_owned, d) [force]: they answer motions, of
        dashpots and of inertia. They are no measure of the forces at work either, for where a body moves freely they
        cancel its load. *Collective.*
        """

    def add_magnitude(self, u, out):
        """Add the sum of the absolute terms of :meth:`residual` to ``out`` (n_owned, d): the scale of rounding errors.
        *Collective.*
        """

    def tangent(self, u, rule=LAW):
        """Values (nnz, d, d) of the generalised Jacobian on :meth:`pattern`, which may grow. *Collective.*"""
        raise NotImplementedError

    # -- a load step ----------------------------------------------------------------------------------------------

    def expected(self, u, time):
        """Displacement (n_owned, d) that is expected at the end of a load step from ``u`` to a time [length]; None for
        no say."""
        return None

    def detect(self, u, time, motion=0.0, ahead=None):
        """Find what the load step depends on and keeps: partners, normals. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
            The committed displacement.
        time : float
            At which the load step ends.
        motion : float
            What the load step is known to move [length].
        ahead : PETSc.Vec, optional
            Displacement among which partners are looked for: where the load step is expected to end.
        """

    def angle(self, start, end):
        """Angle by which an obstacle turns between two times [radian]."""
        return 0.0

    def strays(self, u):
        """Return True if ``u`` is so far from where the load step's partners were found that they are to be found again
        within Newton's method, see :meth:`renew`. *Collective.*"""
        return False

    def normal_motion(self, u, before):
        """Largest motion of a point along its normal between two displacements [length]. *Collective.*"""
        return 0.0

    def renew(self, u, before, time, firm=False, tolerance=0.0):
        """Find again, at a solution ``u``, what the load step that began at ``before`` keeps. *Collective.*

        Parameters
        ----------
        u, before : PETSc.Vec
        time : float
            At which the load step ends.
        firm : bool
            Keep it where it is hardly another one.
        tolerance : float
            Part of the answer that may be wrong with what is kept, see :attr:`stale`.

        Returns
        -------
        bool
            Whether that has changed, so that ``u`` may be no solution any more.
        """
        return False

    def error(self, u):
        """Local error of the load step that ends at ``u``, over the one that is allowed; 0 for no say. *Collective.*"""
        return 0.0

    def commit(self, u, time):
        """End the load step: what the next one needs to know is that of ``u``. *Collective.*"""

    def fields_of_nodes(self):
        """Fields at nodes beside the displacement: values (n_owned, d) by name."""
        return {}

    def report(self, u):
        """Entries of the record of a load step that has been committed at ``u``, the same on every rank: by section,
        and in it by name where several items have one. *Collective.*"""
        return {}

    # -- a checkpoint ---------------------------------------------------------------------------------------------

    def memory(self):
        """State of the last load step that the next one needs, apart from the displacement.

        Returns
        -------
        dict of str to (ndarray (n,), ndarray (n, m))
            Keys of rows, the same on any number of ranks, and their values; rows of zeros are left out.
        """
        return {}

    def memory_keys(self):
        """Keys (n,) of all rows that :meth:`memory` may have; None where it never has any."""
        return None

    def recall(self, name, chunks):
        """Take back what :meth:`memory` gave under a name.

        Parameters
        ----------
        name : str
        chunks : iterable of (ndarray (n,), ndarray (n, m))
            The rows of all ranks, a part at a time.

        Returns
        -------
        int or None
            Rows that were found on this rank; None for a name under which nothing is remembered here.
        """
        return None

    def counters(self):
        """Quadrature points of this rank at which something is kept (``points``), and those with a partner times the
        unknowns that each of them couples (``work``)."""
        return {"points": 0, "work": 0}


class Sum:
    """A number that grows from load step to load step, and that a restarted run goes on with."""

    def __init__(self):
        self.carried = 0.0
