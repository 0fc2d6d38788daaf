"""Contact pairs of two stacked boxes: motions that meet all statuses, tangents against differences."""

import numpy as np
import pytest

from pcontact.contact.law import SLIP
from pcontact.contact.pair import contact_pair
from pcontact.contact.surface.obstacle import RigidObstacle
from pcontact.contact.surface.sides import source_surface, target_surface
from pcontact.material.elastic import lame
from pcontact.runtime.petsc import MPI
from pcontact.scene.amplitude import amplitude
from pcontact.scene.model import Contact, Obstacle
from tests.support.laws import LAWS, limit_of
from tests.support.small import dense_item, keys, vector_of

LIMITED = 2
CONSTANTS = lame(10.0, 0.3)


def tangential(a, normal):
    """Parts (n, d) of rows (n, d), or of one vector (d,), across the normals (n, d)."""
    return a - np.einsum("...d,...d->...", a, normal)[:, None] * normal


def pair(space, contact, radius=1.0, law=None):
    """Item of a contact whose first search is done by the caller."""
    source = source_surface(space, contact.source, [CONSTANTS] * 2, contact.quadrature)
    if contact.obstacle is None:
        target = target_surface(space, contact.target)
    else:
        target = RigidObstacle(contact.obstacle, amplitude(contact.obstacle.amplitude, 1.0), 1.0)
    return contact_pair(space, contact, source, target, radius, law=law)


def bodies(name="coulomb", search="closest_point", theta=0.0, alpha=1.0, **more):
    """Contact of two stacked boxes."""
    said = {**LAWS[name], "gamma0": 1.0, "theta": theta, "alpha": alpha, "search": search, **more}
    return Contact("upper_bottom", "lower_top", **said)


def residual_of(item, array):
    """(n_owned d,)"""
    out = np.zeros((item.space.n_owned, item.space.dim))
    item.residual(vector_of(item.space, array), out)
    return out.ravel()


def state_of(item, array):
    return item.state(vector_of(item.space, array))


def phases(item, array, name):
    """Rows of: status; whether there is a tangential traction (1), the largest of the law (2); pressure or tension."""
    state = state_of(item, array)
    size = np.linalg.norm(tangential(state["traction"], state["normal"]), axis=1)
    kind = (size > 1e-12) + (size > limit_of(name) * (1.0 - 1e-12)).astype(int)
    return np.column_stack([state["status"], kind, np.sign(state["pressure"]).astype(int)])


def farthest(kinds, u, directions):
    """The largest h = 2^-k, and a direction v, for which no point changes on the way to u + h v.

    Parameters
    ----------
    kinds : list of callable
        What must not change, as an array, of a displacement (n_owned, d); the cheapest first.
    u : ndarray (n_owned, d)
    directions : list of ndarray (n_owned, d)
    """
    before = [kind(u) for kind in kinds]
    for h in 0.5 ** np.arange(16):
        for v in directions:
            # as far as halves can tell
            way = [u + part * h * v for part in (1.0, 0.5, 0.25)]
            if all(np.array_equal(kind(x), was) for kind, was in zip(kinds, before, strict=True) for x in way):
                return h, v
    raise AssertionError("points change as soon as anything moves")


def taylor(item, u, name):
    """|R(u + h v) - R(u) - h K v| for h and its halves over the size of the terms.

    Of some directions v the one that goes farthest before a point changes its phase.
    """
    space = item.space
    directions = [motion(space, 0.01, 0.01, 0.01, seed, 0.01) for seed in range(5, 11)]
    h, v = farthest([lambda moved: phases(item, moved, name)], u, directions)
    slope = dense_item(item, vector_of(space, u)) @ v.ravel()
    start = residual_of(item, u)
    scale = max(np.abs(start).max(), np.abs(h * slope).max(), 1e-300)
    errors = []
    for part in h * 0.5 ** np.arange(3, 9):
        change = residual_of(item, u + part * v) - start
        errors.append(np.abs(change - part * slope).max() / scale)
    return np.array(errors)


def check_taylor(item, u, name):
    """Exact where the response is linear, second order where slip may turn; returns the phases."""
    errors, phase = taylor(item, u, name), phases(item, u, name)
    # points that are open slip, too, where the law holds everywhere
    slips = (phase[:, 0] == SLIP) & (phase[:, 1] > 0) | (name == "tresca") & (phase[:, 1] == LIMITED)
    if item.space.dim == 3 and np.any(slips):
        errors = errors[errors > 1e-13]
        assert len(errors) > 1 and errors[-2] / errors[-1] == pytest.approx(4.0, rel=0.05)
    else:
        assert np.all(errors < 1e-13)
    return {(int(status), int(kind)) for status, kind, _ in phase}


def motion(space, depth, slide, tilt=0.0, seed=1, noise=0.002):
    """The upper body (the only one) moved down, along, turned a little; everything a little at random."""
    x = space.points[space.owned_local]
    # bodies are unit boxes on top of each other: the number of the last is the height of its bottom
    last = space.mesh.n_components - 1
    upper = space.component[space.owned_local] == last
    u = noise * np.random.default_rng(seed).normal(size=x.shape)
    arm = x[upper] - [0.7, *[0.5] * (space.dim - 2), last]
    u[upper, -1] -= depth + tilt * arm[:, 0]
    u[upper, 0] += slide + tilt * arm[:, -1]
    u[upper, 1:-1] += 0.5 * slide
    return u


# depth, slide, turn of the second load step: open, sticking, mixtures
STEPS = [(-0.2, 0.0, 0.0), (0.1, 0.0, 0.0), (0.05, 0.006, 0.0), (0.03, 0.008, 0.1), (0.03, 0.03, 0.1), (0.1, 0.6, 0.02)]
OBSTACLES = {
    "plane": {"shape": "plane", "point": [0.0, 0.0, 0.0], "normal": [0.02, 0.03, 1.0]},
    "sphere": {"shape": "sphere", "center": [0.4, 0.4, -1.0], "radius": 1.0},
}


def along(vector, d):
    """A vector of three dimensions in d of them."""
    return np.array([*vector[: d - 1], vector[-1]])


def obstacle_of(name, d, shift=None, table=None):
    """The obstacle in d dimensions, with a motion (3,)."""
    vectors = ("point", "normal", "center")
    said = {key: along(value, d) if key in vectors else value for key, value in OBSTACLES[name].items()}
    return Obstacle(**said, displacement=None if shift is None else along(shift, d), amplitude=table)


def field(space, seed):
    """Displacement (n_owned, d) that depends on the node of the file alone."""
    table = np.random.default_rng(seed).normal(size=(space.mesh.n_nodes_total, space.dim))
    return table[keys(space)[space.owned_local]]


def by_key(space, owned):
    """Owned rows (n_owned, d) of all ranks in the order of the file, on every rank."""
    out = np.zeros((space.mesh.n_nodes_total, space.dim))
    out[keys(space)[space.owned_local]] = owned
    space.comm.Allreduce(MPI.IN_PLACE, out, op=MPI.SUM)
    return out
