"""Loads as forces per area and volume, and what the quadrature of those that vary from place to place leaves out.

Forces and supports are in equilibrium with the loads that the run has integrated: no residual of the displacement tells
how far these are from the loads that the scene names. A rule of a higher degree does.
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.loads import density, load_patches, value_of
from pcontact.assembly.patches import Patch, assembled, kind_of
from pcontact.runtime.parallel import together
from pcontact.scene.amplitude import Squared, amplitude_of
from pcontact.scene.functions import Prescribed

# degrees by which the rule is higher. From: a bump as wide as two facets, with two and three points on each, is then
# known to 1e-6; the highest rule of curved tetrahedra is of degree 20.
HIGHER = 8


class Given:
    """A load of the scene, but for one whose resultant is given.

    Parameters
    ----------
    load : pcontact.scene.model.Load
    amplitude : pcontact.scene.amplitude.Amplitude
    masses : sequence of float
        Density of each body, for forces per mass [mass / length^3].

    Attributes
    ----------
    region : str
    on_facets : bool
        Whether it is a force per area; else per volume.
    """

    def __init__(self, load, amplitude, masses=()):
        self.region, self.on_facets = load.region, load.pressure is not None or load.traction is not None
        self.load, self._factor, self.masses = load, amplitude.factor, masses
        if load.angular_speed is not None:
            self._factor = Squared(amplitude.times, amplitude.factors).factor
        self.prescribed = Prescribed(value_of(load)[1])

    @property
    def per_mass(self):
        """Return True if it is a force per mass."""
        return self.load.acceleration is not None or self.load.angular_speed is not None

    def factor(self, time):
        """Its factor of time."""
        return self._factor(time)

    def density(self, space, patch, time):
        """Force (n, nq, d) per area or volume at the points of a patch, at factor 1."""
        values = density(space, self.load, self.prescribed, patch, time)
        return self.masses[patch.body] * values if self.per_mass else values


class Spread:
    """Forces that are spread over a group so that they have a resultant: a total load, or what holds a mean motion.

    Parameters
    ----------
    region : str
    on_facets : bool
    spread : callable
        ``spread(points)`` per measure, at factor 1.
    amplitude : pcontact.scene.amplitude.Amplitude, optional
        Absent: none.
    """

    def __init__(self, region, on_facets, spread, amplitude=None):
        self.region, self.on_facets, self._spread, self._amplitude = region, on_facets, spread, amplitude

    def factor(self, time):
        """Its factor of time."""
        return 1.0 if self._amplitude is None else self._amplitude.factor(time)

    def density(self, space, patch, time):
        """See :meth:`Given.density`."""
        return self._spread(patch.points)


def applied(problem, scene):
    """The loads of a scene as forces per area and volume, :class:`Given` or :class:`Spread`. *Collective.*"""
    masses = [scene.materials[body.material].density for body in scene.bodies]
    found, total = [], list(problem.features.total)
    for load in scene.loads:
        amplitude = amplitude_of(load, scene.steps.end)
        if load.total:
            one = total.pop(0)
            found.append(Spread(load.region, kind_of(problem.space, load.region) == "facets", one.density, amplitude))
        else:
            found.append(Given(load, amplitude, masses))
    return found


def held(problem, unbalanced):
    """Holding forces of groups that move on average, from forces (n_owned, d) out of equilibrium. *Collective.*"""
    return [Spread(one.region, kind_of(problem.space, one.region) == "facets", one.held_by(unbalanced))
            for one in problem.features.averages]  # fmt: skip


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
    """Forces that quadrature leaves out of loads: :class:`Missing`. *Collective.*"""
    cells = [np.zeros(len(block.nodes)) for block in space.mesh.blocks]
    loads = [one for one in loads if isinstance(one, Given) and one.prescribed.varies]
    if not loads:
        return Missing(None, cells)

    def parts():
        found = []
        for one in loads:
            rules = load_patches(space, one.load, HIGHER), load_patches(space, one.load)
            for finer, usual in zip(*rules, strict=True):
                values = [patch.forces(one.density(space, patch, time)) for patch in (finer, usual)]
                found.append((usual, one.factor(time) * (values[0] - values[1])))
        return found

    found = together(space.comm, parts)
    for patch, forces in found:
        np.add.at(cells[patch.block], patch.cells, np.sum(forces**2, axis=(1, 2)))
    return Missing(assembled(space, [(patch.nodes, forces) for patch, forces in found]), cells)


def force_density(space, load, points, normals, body, time):
    """Force (n, nq, d) of a load per area or volume at points (n, nq, d) of a body, with normals there or None in
    cells; where it is not finite the run has said so."""
    none = np.zeros((len(points), 0), dtype=np.int64)
    patch = Patch(none, np.zeros((*points.shape[:2], 0)), np.zeros(points.shape[:2]), points, normals, body)
    return load.factor(time) * load.density(space, patch, time)
