"""External forces: pressures and tractions on facets, forces in bodies."""

import numpy as np

from pcontact.assembly.geometry import chunks
from pcontact.assembly.patches import assembled, cell_patches, facet_patches
from pcontact.runtime.parallel import together
from pcontact.scene.prescribed import Prescribed

# degree of the polynomial up to which a force density in cells is integrated exactly
SMOOTH = 2


def density(load, prescribed, patch, time):
    """Force per area or volume (n, nq, d) of a load at the points of a patch, without its factor of time.

    Parameters
    ----------
    load : pcontact.scene.model.Load
    prescribed : pcontact.scene.prescribed.Prescribed
        Of its value.
    patch : pcontact.assembly.patches.Patch
    time : float

    Raises
    ------
    InputError
        On this rank: a value is not finite.
    """
    shape = patch.points.shape
    values = prescribed(patch.points.reshape(-1, shape[2]), time).reshape(*shape[:2], -1)
    return -values * patch.normals if load.pressure is not None else values


def value_of(load):
    """The key of a load that says its size, and its value."""
    return next((key, getattr(load, key)) for key in ("pressure", "traction", "body_force")
                if getattr(load, key) is not None)  # fmt: skip


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


def load_vector(space, load, prescribed=None, time=0.0):
    """Nodal forces of a load at factor 1. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    load : pcontact.scene.model.Load
        ``pressure`` acts against the outward normal, ``traction`` [stress] and ``body_force`` [force/volume] as given.
    prescribed : pcontact.scene.prescribed.Prescribed, optional
        Of its value, for messages that name the scene.
    time : float
        Of expressions.

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
    patches = facet_patches(space, load.region) if load.body_force is None else cell_patches(space, load.region, SMOOTH)

    def parts():
        return [(patch.nodes, patch.forces(density(load, prescribed, patch, time))) for patch in patches]

    return assembled(space, together(space.comm, parts))


class TimedLoad:
    """A load whose expressions have the time: integrated anew for every load step.

    Parameters
    ----------
    space : pcontact.space.space.Space
    load : pcontact.scene.model.Load
    prescribed : pcontact.scene.prescribed.Prescribed
    amplitude : pcontact.scene.amplitude.Amplitude
    """

    def __init__(self, space, load, prescribed, amplitude):
        self._space, self._load, self._prescribed, self._amplitude = space, load, prescribed, amplitude
        self._time, self._forces = None, None

    def at(self, time):
        """Nodal forces (n_owned, d) [force]. *Collective.*"""
        if time != self._time:
            self._forces = load_vector(self._space, self._load, self._prescribed, time)
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
