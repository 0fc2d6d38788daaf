"""Prescribed displacements: supports, and components that follow others, of rigid groups and equations."""

import numpy as np

from pcontact.assembly.matrix import ConstrainedMatrix, GlobalMatrix


class EssentialConditions:
    """Prescribed components of the displacement, and those that follow others.

    Parameters
    ----------
    space : pcontact.space.space.Space
    supports : pcontact.space.supports.Supports
    features : pcontact.solve.problem.Features
        Its `release` says how far supports have begun beside what they prescribe.

    Attributes
    ----------
    fixed : ndarray (n_owned, d) of bool
        Prescribed components.
    groups : sequence of pcontact.space.constraints.RigidGroup
        Whose displacement is rigid, sections, and equations: Newton's method has their leading components.
    matrix : GlobalMatrix or ConstrainedMatrix
        Of the unknowns, without entries.
    followers : ndarray (n_owned, d) of bool or None
        Components that follow others and are none of the linear system's; None without any.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space, supports, features):
        self._space, self.supports, self.groups, self._features = space, supports, supports.groups, features
        self.fixed = np.ascontiguousarray(supports.fixed[space.owned_local])
        self.matrix = self.new_matrix()
        self.followers = self.matrix.follows if self.groups else None

    def new_matrix(self):
        """A matrix of the unknowns, without entries. *Collective.*"""
        space, fixed = self._space, self.supports.fixed
        return ConstrainedMatrix(space, fixed, self.groups) if self.groups else GlobalMatrix(space, fixed)

    def _values(self, time):
        """Prescribed displacements (n_owned, d) [length]. *Collective.*"""
        values = self.supports.values(time)[self._space.owned_local]
        release = self._features.release
        return values if release is None else values + release.shift(time)

    def enter(self, u, time):
        """Enter the prescribed displacements of a time into ``u``. *Collective.*"""
        values = self._values(time)
        array = u.getArray().reshape(values.shape)
        array[self.fixed] = values[self.fixed]
        for group in self.groups:
            group.enter(array, time)
        u.assemble()

    def imposed(self, u, time):
        """Largest change that the prescribed displacements make to ``u`` [length]. *Collective.*"""
        values = self._values(time)
        before = u.getArray(readonly=True).reshape(values.shape)
        change = np.where(self.fixed, values - before, 0.0)
        if self.groups:
            after = before.copy()
            for group in self.groups:
                group.enter(after, time)
            change += after - before
        return self._space.longest(change)

    def follow(self, y, x=None, start=None):
        """Prescribed components stay where they are in a step ``y``; what follows others does so. *Collective.*

        Parameters
        ----------
        y : PETSc.Vec
        x, start : PETSc.Vec, optional
            Displacements: from ``x`` the step ``-y`` goes on, in ``start`` components followed, and so they do after
            the step. No residual tells of the rounding errors that larger iterates have left in those that follow.
        """
        array = y.getArray().reshape(self.fixed.shape)
        array[self.fixed] = 0.0
        if self.followers is not None:
            before = 0.0
            if x is not None:
                before = (x.getArray(readonly=True) - start.getArray(readonly=True)).reshape(array.shape)
            after = before - array
            for group in self.groups:
                group.follow(after)
            array[self.followers] = (before - after)[self.followers]
        y.assemble()

    def condense(self, out):
        """Leave of forces (n_owned, d) what supports and groups do not bear, in place: zero at prescribed components
        and at those that follow, whose forces go to the others. *Collective.*"""
        out[self.fixed] = 0.0
        for group in self.groups:
            group.lead(out)
        if self._features.equations is not None:
            # some of what follows goes along with what is prescribed
            out[self.fixed] = 0.0
