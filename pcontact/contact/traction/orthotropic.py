"""The traction of orthotropic cells: that of their nearest isotropic elasticity, and C_dev : eps(u) n_X.

It is linear, so its derivative is known once and for all, at a point and by node

    d t_i / d u_aj = sum_(k, l) N_ik C_dev,kl B_l,aj

with the strain operator B of the parent cell at the point, and N from stresses to the traction on n_X. The adjoint of
theta = 1 and -1 has it, too: the method is consistent, and symmetric where that of an isotropic body is.
"""

import numpy as np

from pcontact.assembly.orthotropic import NO_RING
from pcontact.assembly.plastic_kernels import CellPoints, fill_operator, pull
from pcontact.contact.points import Excess
from pcontact.contact.traction.elastic import ElasticTraction
from pcontact.contact.traction.plastic import add_rows_adjoint
from pcontact.element.dilatation import hoop_operator
from pcontact.material.orthotropic import traction_matrix
from pcontact.runtime.jit import njit


@njit
def traction_rows(points, moduli, onto, out):
    """Derivative of the traction C : eps n at points.

    Parameters
    ----------
    points : pcontact.assembly.plastic_kernels.CellPoints
        A cell for each of the n points.
    moduli : ndarray (k, m, m)
        C [stress], k = 1 or n.
    onto : ndarray (n, d, m)
        From Mandel stresses to tractions.
    out : ndarray (n, nn, d, d)
        Overwritten [stress/length].
    """
    nn, d, m = points.grad.shape[2], points.grad.shape[3], moduli.shape[1]
    operator, pulled = np.zeros((m, nn, d)), np.zeros((m, nn * d))
    flat = operator.reshape(m, nn * d)
    out[:] = 0.0
    for p in range(len(out)):
        fill_operator(points, p, 0, operator)
        pull(moduli[p if len(moduli) > 1 else 0], flat, 1.0, pulled)
        for i in range(d):
            for k in range(m):
                factor = onto[p, i, k]
                if factor != 0.0:
                    for a in range(nn):
                        for j in range(d):
                            out[p, a, i, j] += factor * pulled[k, a * d + j]


@njit
def _add_tractions(at, rows, values, cells, facet, out):
    """Add the rows of the points times nodal values (n, d) to tractions (np, d)."""
    d = values.shape[1]
    for p in range(len(at)):
        if at[p] < 0:
            continue
        for a in range(cells.shape[1]):
            node = cells[facet[p], a]
            for i in range(d):
                for j in range(d):
                    out[p, i] += rows[at[p], a, i, j] * values[node, j]


class OrthotropicTrace:
    """Derivative of the traction of C_dev at the points of a source surface.

    Parameters
    ----------
    space : pcontact.space.space.Space
    orthotropic : dict of int to pcontact.material.orthotropic.Orthotropic
        By body.
    source : pcontact.contact.surface.sides.SourceSurface
    name : str
        Its facet group.

    Attributes
    ----------
    at : ndarray (np,)
        Row of each point in ``rows``, -1 where the parent cell is isotropic.
    rows : ndarray (n, nn, d, d)
        [stress/length]
    """

    def __init__(self, space, orthotropic, source, name):
        self.at, found, first, count = np.full(len(source.facet), -1, dtype=np.int64), [], 0, 0
        ring = hoop_operator(source.shape, source.x[:, 0]) if source.axisymmetric else None
        # facets without a shear modulus take part without their traction
        speaks = source.mu[source.facet] > 0.0
        for facets in space.mesh.facet_groups.get(name, []):
            last, law = first + len(facets.cells), orthotropic.get(space.mesh.blocks[facets.block].body)
            some = np.flatnonzero((source.facet >= first) & (source.facet < last) & speaks)
            first = last
            if law is None or not len(some):
                continue
            around = NO_RING if ring is None else np.ascontiguousarray(ring[some][:, None])
            points = CellPoints(np.zeros((0, 0), dtype=np.int64), source.grad[some][:, None], around)
            rows = np.empty((len(some), *source.grad.shape[1:], source.grad.shape[2]))
            x = source.x[some[:1]] if law.uniform else source.x[some]
            traction_rows(points, law.deviation(x), traction_matrix(source.normal[some]), rows)
            self.at[some] = np.arange(count, count + len(some))
            count += len(some)
            found.append(rows)
        shape = (*source.grad.shape[1:], source.grad.shape[2])
        self.rows = np.concatenate([np.zeros((0, *shape)), *found])


class OrthotropicTraction(ElasticTraction):
    """A traction with that of C_dev added.

    Parameters
    ----------
    rest : ElasticTraction
        The traction without.
    trace : OrthotropicTrace
    weighs : bool
        Whether there is an adjoint term: theta is not 0.
    """

    def __init__(self, rest, trace, weighs):
        super().__init__(rest.source)
        self._rest, self._trace = rest, trace
        self.consistent, self.symmetric, self.jumps = weighs, rest.symmetric, rest.jumps

    def linear(self, values, p, wanted):
        """See :meth:`ElasticTraction.linear`; of points that are not wanted something else."""
        out = self._rest.linear(values, p, wanted)
        _add_tractions(self._trace.at, self._trace.rows, values, p.cells, self.source.facet, out)
        return out

    def add_excess(self, values, p, traction):
        """See :meth:`ElasticTraction.add_excess`."""
        self._rest.add_excess(values, p, traction)
        _add_tractions(self._trace.at, self._trace.rows, values, p.cells, self.source.facet, traction)

    def add_normal_excess(self, values, p, traction):
        """See :meth:`ElasticTraction.add_normal_excess`."""
        self._rest.add_normal_excess(values, p, traction)
        own = np.zeros_like(self.source.x)
        _add_tractions(self._trace.at, self._trace.rows, values, p.cells, self.source.facet, own)
        traction += np.einsum("pd,pd->p", own, p.normal)

    def excess(self, values, p):
        """See :meth:`ElasticTraction.excess`."""
        rest, own = self._rest.excess(values, p), self._trace
        if not len(rest.rows):
            return Excess(own.at, own.rows, 0)
        # no cell is orthotropic and yields
        at = np.where(own.at >= 0, own.at + len(rest.rows), rest.at)
        return Excess(at, np.concatenate([rest.rows, own.rows]), rest.adjoint)

    def add_adjoint(self, values, p, weights, out):
        """See :meth:`ElasticTraction.add_adjoint`."""
        if self._rest.consistent:
            self._rest.add_adjoint(values, p, weights, out)
        add_rows_adjoint(self._trace.at, self._trace.rows, weights, p.cells, self.source.facet, out)

    def add_curvature(self, values, p, weights, blocks):
        """See :meth:`ElasticTraction.add_curvature`."""
        return self._rest.add_curvature(values, p, weights, blocks) if self._rest.consistent else 0
