"""Linear constraints u = W u_lead + g: components of the displacement that follow others, by one sparse W.

Newton's method does not have the components that follow: its matrix is P^T K P and its residual P^T f, P the identity
with the rows W of those that follow. A displacement that satisfies the constraints does the same work on P^T f as on f.
Rigid groups, sections across bolts and equations differ in the rows that they have and in g.
"""

import numpy as np


class Constraint:
    """Components that follow others; kinds set the rows once, and say what is given.

    Attributes
    ----------
    leading : ndarray (m,)
        Global numbers of components that lead although they are among the rows, with 1 in their own.
    """

    leading = np.zeros(0, dtype=np.int64)

    def _set(self, at, row, column, weight, free=slice(None)):
        """Take the rows of what follows on this rank. *Collective.*

        Parameters
        ----------
        at : ndarray (n,)
            Owned components that follow.
        row, column, weight : ndarray (k,)
            Entries of W: which of `at`, global number of the component that leads, weight.
        free : ndarray (k,) of bool or slice
            Entries of components that no support prescribes.
        """
        d, self._at, self._row, self._column = self._space.dim, at, row, column
        self._weight, self._free = weight, free
        needed, node = np.unique(column // d, return_inverse=True)
        self._entry, self._count = node * d + column % d, len(needed) * d
        self._exchange = self._space.exchange(needed)

    def ways(self):
        """Rows, columns and values of W on this rank: rows of owned components, columns global."""
        return self._at[self._row[self._free]], self._column[self._free], self._weight[self._free]

    def followers(self):
        """Owned components (n,) that follow, those that lead among them."""
        return self._at

    def follow(self, y):
        """Let components follow in a step (n_owned, d). *Collective.*"""
        vector = self._space.vector()
        vector.setArray(y.ravel())
        values = self._exchange.gather(vector).ravel()[self._entry]
        vector.destroy()
        y.reshape(-1)[self._at] = np.bincount(self._row, self._weight * values, minlength=len(self._at))

    def lead(self, f):
        """Take forces (n_owned, d) on components that follow to the others. *Collective.*"""
        values = np.bincount(self._entry, self._weight * f.reshape(-1)[self._at][self._row], self._count)
        passed = self._space.summed(self._exchange, values.reshape(-1, self._space.dim))
        f.reshape(-1)[self._at] = 0.0
        f += passed

    def enter(self, u, time):
        """Let components be where a displacement (n_owned, d) and what is given at a time have them. *Collective.*"""
        given = self.given(u, time)
        self.follow(u)
        u.reshape(-1)[self._at] += given

    def bring(self, u, fresh):
        """Let nodes that are there from now on, flags (n_owned,), go along with the others in a displacement
        (n_owned, d). Whether others say where to. *Collective.*"""
        return False

    def hold(self, modes):
        """What rigid motions (n_modes, n_local, d) of the bodies do that is prescribed, on rank 0, see
        :func:`pcontact.space.modes.free_motions`. *Collective.*"""
        return np.zeros((self._space.mesh.n_components, len(modes), len(modes)))


def gathered(space, region, *more):
    """Global numbers (n,), places (n, d) and rows of more tables (n_local, ...) of all nodes of a region, on all ranks
    alike. *Collective.*"""
    nodes = space.region(region)
    own = nodes[space.owns(nodes)]
    parts = space.comm.allgather((space.nodes[own], space.points[own], *(table[own] for table in more)))
    return tuple(np.concatenate(one) for one in zip(*parts, strict=True))

