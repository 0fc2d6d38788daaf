"""What the quadrature of loads that vary from place to place leaves out of their forces.

Forces and supports are in equilibrium with the loads that the run has integrated: no residual of the displacement tells
how far these are from the loads that the scene names. A rule of a higher degree does.
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.loads import density, load_patches, value_of
from pcontact.assembly.patches import assembled
from pcontact.runtime.parallel import together
from pcontact.scene.prescribed import Prescribed

# degrees by which the rule is higher. From: a bump as wide as two facets, with two and three points on each, is then
# known to 1e-6; the highest rule of curved tetrahedra is of degree 20.
HIGHER = 8


class Missing(NamedTuple):
    """Forces that quadrature leaves out.

    Attributes
    ----------
    forces : ndarray (n_owned, d) or None
        Of the owned nodes [force]; None where no load varies from place to place.
    cells : list of ndarray (nc,)
        Squared forces of the cells of each block [force^2].
    """

    forces: np.ndarray | None
    cells: list


def missing(space, loads, time):
    """What quadrature leaves out of loads. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    loads : list of (pcontact.scene.model.Load, pcontact.scene.amplitude.Amplitude)
        Tractions, pressures and body forces.
    time : float

    Returns
    -------
    Missing
    """
    cells = [np.zeros(len(block.nodes)) for block in space.mesh.blocks]
    loads = [(load, amplitude, Prescribed(value_of(load)[1])) for load, amplitude in loads]
    loads = [one for one in loads if one[2].varies]
    if not loads:
        return Missing(None, cells)

    def parts():
        found = []
        for load, amplitude, prescribed in loads:
            rules = load_patches(space, load, HIGHER), load_patches(space, load)
            for finer, usual in zip(*rules, strict=True):
                values = [patch.forces(density(space, load, prescribed, patch, time)) for patch in (finer, usual)]
                found.append((usual, amplitude.factor(time) * (values[0] - values[1])))
        return found

    found = together(space.comm, parts)
    for patch, forces in found:
        np.add.at(cells[patch.block], patch.cells, np.sum(forces**2, axis=(1, 2)))
    return Missing(assembled(space, [(patch.nodes, forces) for patch, forces in found]), cells)

