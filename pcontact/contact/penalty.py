"""The penalty method at Nitsche's quadrature points: no traction of the bodies, and no adjoint term.

    residual  R = - int P . [[v]],   tau = gamma g n - alpha gamma D_T,   P the projection of tau on what the law admits

is Nitsche's residual for theta = 0 with t = 0. A source without an operator for its traction is therefore all it takes:
the items and kernels of Nitsche's method do the rest. Of the parent cells the nodes on their facets remain, so that the
pattern is smaller, too. Stress and internal variables of the cells do not enter: bodies may yield at no cost.

The traction follows from the motion of the bodies: where they touch the gap is -p / gamma, where they stick the slip is
traction over alpha gamma, and the next load step begins with that traction (see `pcontact.contact.frictional`).
"""

import dataclasses

import numpy as np

# shape functions below this are those of nodes off the facet
OFF = 1e-12


def without_traction(source):
    """The source surface without what its traction is made from.

    Parameters
    ----------
    source : pcontact.contact.surface.SourceSurface

    Returns
    -------
    SourceSurface
        The same points; ``cells`` (nf, m) and ``shape`` (np, m) have the nodes of the facets alone, ``grad`` and
        ``volumetric`` are of width 0.
    """
    nf, nn = source.cells.shape
    largest = np.zeros((nf, nn))
    np.maximum.at(largest, source.facet, np.abs(source.shape))
    on = largest > OFF
    width = int(on.sum(axis=1).max(initial=1))
    columns = np.argsort(~on, axis=1, kind="stable")[:, :width]
    kept = np.take_along_axis(on, columns, axis=1)
    every = columns[source.facet]
    shape = np.where(kept[source.facet], np.take_along_axis(source.shape, every, axis=1), 0.0)
    return dataclasses.replace(
        source,
        cells=np.ascontiguousarray(np.take_along_axis(source.cells, columns, axis=1)),
        shape=np.ascontiguousarray(shape),
        grad=np.zeros((len(source.facet), 0, source.x.shape[1])),
        shared=None,
        axisymmetric=False,
    )
