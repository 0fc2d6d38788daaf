"""What the traction of a source lacks whose bodies have begun without strain: the part of it that is linear, at
the displacement from which their strain is counted. `pcontact.contact.traction.plastic` counts what yielding adds so.
"""

from typing import NamedTuple

import numpy as np

from pcontact.contact.points import SourcePoints
from pcontact.runtime.petsc import MPI


class _Local(NamedTuple):
    """The points of a source, whose ``cells`` (nf, nn) are local nodes: in the place of a pairing."""

    source: SourcePoints
    cells: np.ndarray


class StrainFreeTrace:
    """Minus the linear traction at that displacement.

    Parameters
    ----------
    space : pcontact.space.space.Space
    bulk : pcontact.assembly.item.Bulk
        Has it, once it is known.
    source : pcontact.contact.surface.sides.SourceSurface
    name : str
        Its facet group.
    """

    def __init__(self, space, bulk, source, name):
        self._bulk, self._of, self._values, first = bulk, None, None, 0
        # block of each facet, -1 of those that are there from the beginning
        self._block = np.full(len(source.cells), -1, dtype=np.int64)
        for facets in space.mesh.facet_groups.get(name, []):
            last = first + len(facets.cells)
            if facets.block in bulk.added:
                self._block[first:last] = facets.block
            first = last

    @property
    def some(self):
        """Whether this rank has such facets."""
        return bool((self._block >= 0).any())

    def tractions(self, rest):
        """Tractions (np, d) at the points of the source of a traction [stress]."""
        if self._of is not self._bulk.origins or self._values is None:
            self._of, self._values = self._bulk.origins, self._evaluated(rest)
        return self._values

    def _evaluated(self, rest):
        source = rest.source
        result, at = np.zeros_like(source.x), self._block[source.facet]
        local = _Local(SourcePoints(source.facet, source.cells, source.shape, source.jxw, source.normal, source.grad,
                                    source.volumetric, source.mu), source.cells)  # fmt: skip
        for number, origin in self._bulk.origins.items():
            wanted = at == number
            if wanted.any():
                result[wanted] -= rest.linear(origin, local, wanted)[wanted]
        return result


def strain_free(space, bulk, source, name):
    """The :class:`StrainFreeTrace` of a source; None where its bodies are there from the beginning. *Collective.*"""
    if not bulk.added:
        return None
    trace = StrainFreeTrace(space, bulk, source, name)
    return trace if space.comm.allreduce(trace.some, op=MPI.LOR) else None
