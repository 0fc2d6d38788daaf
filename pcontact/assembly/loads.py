"""External forces: pressures and tractions on facets, forces in bodies."""

import numpy as np

from pcontact.assembly.geometry import chunks
from pcontact.assembly.patches import assembled, cell_patches, facet_patches
from pcontact.runtime.parallel import together
from pcontact.runtime.petsc import MPI
from pcontact.scene.functions import Prescribed
from pcontact.scene.model import LOADS, Load

# degree of the polynomial up to which a force density in cells is integrated exactly
SMOOTH = 2


def across(space, load):
    """Matrix that takes places relative to the axis of a load with `angular_speed` to those across it (d, d)."""
    if space.axisymmetric:
        return np.diag([1.0, 0.0])
    if load.axis is None:
        return np.eye(2)
    axis = np.asarray(load.axis, dtype=float) / np.linalg.norm(load.axis)
    return np.eye(3) - np.outer(axis, axis)


def _centrifugal(space, load, points):
    """Force per mass (n, nq, d) at points of bodies that turn."""
    point = 0.0 if load.point is None else np.asarray(load.point, dtype=float)
    return load.angular_speed**2 * (points - point) @ across(space, load)


def density(space, load, prescribed, patch, time):
    """Force per area, volume or mass (n, nq, d) of a load at the points of a patch, without its factor of time.

    Parameters
    ----------
    space : pcontact.space.space.Space
    load : pcontact.scene.model.Load
    prescribed : pcontact.scene.functions.Prescribed
        Of its value.
    patch : pcontact.assembly.patches.Patch
    time : float

    Raises
    ------
    InputError
        On this rank: a value is not finite.
    """
    if load.angular_speed is not None:
        return _centrifugal(space, load, patch.points)
    shape = patch.points.shape
    values = prescribed(patch.points.reshape(-1, shape[2]), time).reshape(*shape[:2], -1)
    return -values * patch.normals if load.pressure is not None else values


def value_of(load):
    """The key of a load that says its size, and its value."""
    return next((key, getattr(load, key)) for key in LOADS if getattr(load, key) is not None)


def _constant_body_force(space, load):
    """Nodes and forces of the cells of a load that is the same everywhere."""
    groups = space.mesh.cell_groups[load.region]
    for number, cells in enumerate(space.cells):
        if number >= len(groups) or not len(groups[number]):
            continue
        chosen = np.zeros(len(cells), dtype=bool)
        chosen[groups[number]] = True
        for rows, _, jxw, values in chunks(space, number):
            weight = (jxw @ values) * chosen[rows][:, None]
            yield cells[rows], weight[:, :, None] * np.asarray(load.body_force, dtype=float)


def load_patches(space, load, more=0):
    """The quadrature points of a load, of rules whose degree is higher by `more` than that of a run."""
    on_facets = load.pressure is not None or load.traction is not None
    return facet_patches(space, load.region, more) if on_facets else cell_patches(space, load.region, SMOOTH + more)


def load_vector(space, load, prescribed=None, time=0.0, masses=()):
    """Nodal forces of a load at factor 1. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    load : pcontact.scene.model.Load
        ``pressure`` acts against the outward normal, ``traction`` [stress] and ``body_force`` [force/volume] as given.
    prescribed : pcontact.scene.functions.Prescribed, optional
        Of its value, for messages that name the scene.
    time : float
        Of expressions.
    masses : sequence of float
        Density of each body, for forces per mass [mass / length^3].

    Returns
    -------
    ndarray (n_owned, d)
        Forces [force] of the owned nodes (of the whole circumference with axial symmetry), and nothing for prescribed
        components is taken out here.

    Raises
    ------
    InputError
        On every rank: a value is not finite.
    """
    prescribed = Prescribed(value_of(load)[1]) if prescribed is None else prescribed
    if load.body_force is not None and not prescribed.varies:
        return assembled(space, _constant_body_force(space, load))
    patches = load_patches(space, load)
    per_mass = load.acceleration is not None or load.angular_speed is not None

    def forces(patch):
        mass = masses[patch.body] if per_mass else 1.0
        return patch.nodes, mass * patch.forces(density(space, load, prescribed, patch, time))

    return assembled(space, together(space.comm, lambda: [forces(patch) for patch in patches]))


def region_weights(space, region):
    """Weights (n_owned,) of the nodes of a region in a mean over its area or volume, their sum of all ranks, and the
    key of a load with such forces; of a region without area, as the axis of symmetry, and of points each node counts
    once, and the key is None. *Collective.*
    """
    kinds = [space.mesh.facet_groups, space.mesh.cell_groups]
    found = [space.comm.allreduce(region in groups, op=MPI.LOR) for groups in kinds]
    unit = np.eye(space.dim)[0].tolist()
    for key, has in zip(("traction", "body_force"), found, strict=True):
        weights = load_vector(space, Load(region, **{key: unit}))[:, 0] if has else np.zeros(space.n_owned)
        total = space.comm.allreduce(float(weights.sum()), op=MPI.SUM)
        if total > 0.0:
            return weights, total, key
    weights = np.zeros(space.n_local)
    weights[space.region(region)] = 1.0
    weights = weights[space.owned_local]
    return weights, space.comm.allreduce(float(weights.sum()), op=MPI.SUM), None


class TimedLoad:
    """A load whose expressions have the time: integrated anew for every load step.

    Parameters
    ----------
    space : pcontact.space.space.Space
    load : pcontact.scene.model.Load
    prescribed : pcontact.scene.functions.Prescribed
    amplitude : pcontact.scene.amplitude.Amplitude
    masses : sequence of float
        See :func:`load_vector`.
    """

    def __init__(self, space, load, prescribed, amplitude, masses=()):
        self._space, self._load, self._prescribed, self._amplitude = space, load, prescribed, amplitude
        self._masses = masses
        self._time, self._forces = None, None

    def at(self, time):
        """Nodal forces (n_owned, d) [force]. *Collective.*"""
        if time != self._time:
            self._forces = load_vector(self._space, self._load, self._prescribed, time, self._masses)
            self._forces *= self._amplitude.factor(time)
            self._time = time
        return self._forces


def lumped_volume(space):
    """Volume that belongs to each owned node (n_owned,), positive. *Collective.*"""
    local = np.zeros((space.n_local, space.dim))
    for number, cells in enumerate(space.cells):
        for rows, _, jxw, _ in chunks(space, number):
            # equal shares: row sums of the mass matrix are not positive at the vertices of quadratic simplices
            share = jxw.sum(axis=1) / cells.shape[1]
            np.add.at(local[:, 0], cells[rows], share[:, None])
    total = space.vector()
    space.local.add(local, total)
    return total.getArray().reshape(-1, space.dim)[:, 0].copy()
