"""The pressure of a contact as a function of place: what `named_error.py` compares in L2.

Points and facets are those of the source in the reference configuration, which the meshes of a scene share: facets of
finer meshes are parts of those of the first one. A solution that stands for the exact one has its pressures at the
quadrature points of its own, smaller facets, and so the integral is taken there. In space it is taken at the points of
the other solution, where the pressure of the smaller facets is that of a plane through their own points.

That solution is the one of a run that names a several times smaller error of the pressure. What it may lack itself is
what it names, but for facets, which it shares with the rows.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drivers._common import log
from drivers.studies._named_reference import BUDGET, finer
from pcontact.adapt.loop import Loop
from pcontact.adapt.settings import FACETS
from pcontact.scene.target import Target

# [-] Part of the length of a facet by which points may be beyond its ends, where they are on no other. From: rounding.
BEYOND = 1e-6
# points whose facets are sought at once
POINTS = 1024
# facets in space among which that of a point is sought: those with the nearest middles
NEAR = 16


class Pressure(NamedTuple):
    """That of a solution.

    Attributes
    ----------
    x : ndarray (n, d)
        Reference positions of the quadrature points [length].
    value, weight : ndarray (n,)
        Pressure [stress], and area of the points.
    facet : ndarray (n,)
        Facet of each point.
    ends : ndarray (nf, d, d)
        Vertices of the facets in the plane, the first three or two in space [length].
    """

    x: np.ndarray
    value: np.ndarray
    weight: np.ndarray
    facet: np.ndarray
    ends: np.ndarray

    @classmethod
    def of(cls, simulation, name):
        """That of a contact of a run on one rank."""
        contact = next(one for one in simulation.problem.contacts if one.name == name)
        state, source, space = contact.state(simulation.stepper.u), contact.source, simulation.problem.space
        groups = [facets for group in contact.groups for facets in space.mesh.facet_groups[group]]
        ends = [space.points[space.facet_nodes(facets)[:, : space.dim]] for facets in groups]
        return cls(source.x, state["pressure"], state["weight"], source.facet, np.concatenate(ends))

    @property
    def norm(self):
        """In L2."""
        return float(np.sqrt(self.weight @ self.value**2))

    def off(self, exact):
        """Error in L2 where the pressure is known, and is the same everywhere, relative.

        Parameters
        ----------
        exact : float
            [stress]
        """
        return float(np.sqrt(self.weight @ (self.value / exact - 1.0) ** 2 / self.weight.sum()))

    def distance(self, other):
        """Difference to another solution on larger facets, in L2, relative."""
        if self.x.shape[1] == 3:
            return float(np.sqrt(other.weight @ (self.on_facets(other.x) - other.value) ** 2)) / self.norm
        return float(np.sqrt(self.weight @ (other.at(self.x) - self.value) ** 2)) / self.norm

    def at(self, x):
        """The pressure (n,) at points (n, 2) of the facets: between the quadrature points of a facet along straight
        lines, which go on to its ends."""
        begin, along = self.ends[:, 0], self.ends[:, 1] - self.ends[:, 0]
        size = np.linalg.norm(along, axis=1)
        where, found = np.sum((self.x - begin[self.facet]) * (along / size[:, None] ** 2)[self.facet], axis=1), []
        order = np.lexsort((where, self.facet))
        first = np.searchsorted(self.facet[order], np.arange(len(size) + 1))
        for some in np.split(x, range(POINTS, len(x), POINTS)):
            rest = some[:, None] - begin
            place = np.einsum("nfd,fd->nf", rest, along) / size**2
            aside = np.abs(rest[:, :, 0] * along[:, 1] - rest[:, :, 1] * along[:, 0]) / size
            outside = np.maximum(np.maximum(-place, place - 1.0), 0.0)
            facet = np.argmin(aside + np.where(outside > BEYOND, 1e3, 1.0) * outside * size, axis=1)
            found.append(np.column_stack([facet, place[np.arange(len(some)), facet]]))
        facet, place = np.concatenate([np.zeros((0, 2)), *found]).T
        value = np.zeros(len(x))
        for one in np.unique(facet.astype(np.int64)):
            rows, own = facet == one, order[first[one] : first[one + 1]]
            value[rows] = _line(place[rows], where[own], self.value[own])
        return np.maximum(value, 0.0)

    def on_facets(self, x):
        """The pressure (n,) at points (n, 3): that of the plane nearest to those of the points of a facet."""
        origin, sides = self.ends[:, 0], self.ends[:, 1:] - self.ends[:, :1]
        inverse = np.linalg.pinv(sides.transpose(0, 2, 1))
        own = np.einsum("pkd,pd->pk", inverse[self.facet], self.x - origin[self.facet])
        terms, count = np.column_stack([np.ones(len(own)), own]), len(self.ends)
        matrix, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
        np.add.at(matrix, self.facet, terms[:, :, None] * terms[:, None, :])
        np.add.at(right, self.facet, terms * self.value[:, None])
        # facets with few points, or none, have the smallest plane
        plane = np.einsum("fij,fj->fi", np.linalg.pinv(matrix, hermitian=True), right)
        middles, near = self.ends.mean(axis=1), np.zeros((len(x), min(NEAR, count)), dtype=np.int64)
        for rows in np.split(np.arange(len(x)), range(POINTS, len(x), POINTS)):
            far = np.sum((x[rows, None] - middles) ** 2, axis=2)
            near[rows] = np.argpartition(far, near.shape[1] - 1, axis=1)[:, : near.shape[1]]
        place = np.einsum("nfkd,nfd->nfk", inverse[near], x[:, None] - origin[near])
        aside = np.linalg.norm(x[:, None] - origin[near] - np.einsum("nfk,nfkd->nfd", place, sides[near]), axis=2)
        outside = np.maximum(np.maximum(-place.min(axis=2), place.sum(axis=2) - 1.0), 0.0)
        size = np.linalg.norm(sides, axis=2).max(axis=1)[near]
        best = np.argmin(outside + aside / size, axis=1), np.arange(len(x))
        facet, place = near[best[1], best[0]], place[best[1], best[0]]
        return np.maximum(plane[facet, 0] + np.sum(plane[facet, 1:] * place, axis=1), 0.0)

    def write(self, path, error):
        """Keep it in a file, with the error that it may have."""
        np.savez(path, error=error, **self._asdict())

    @classmethod
    def read(cls, path):
        """That of a file, and its error."""
        with np.load(path) as data:
            return cls(*(data[name] for name in cls._fields)), float(data["error"])


def made(scene, target, name, steps=1):
    """The pressure that stands for the exact one of a scene, on one rank, and what it may lack, relative.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
    target : float
        Its own, of the pressure.
    name : str
        Of the contact.
    steps : int
        Load steps that it begins with, at least.

    Raises
    ------
    StepFailure
        A load step did not converge.
    """
    scene, kept = replace(finer(scene, steps), accuracy=Target(target, f"pressure:{name}", budget=BUDGET)), []

    def take(simulation, converged):
        kept[:] = [Pressure.of(simulation, name)] if converged else []

    loop = Loop(scene, take=take)
    failure = loop.run().failure
    if failure is not None:
        raise failure
    last = loop.passes[-1]
    error = sum(value for part, value in last.parts.items() if part not in FACETS)
    log.info("reference of the pressure: %d unknowns, %d load steps, error %.3g", last.unknowns, last.steps, error)
    return kept[0], error


def _line(s, known, values):
    """Values at s of the line through known ones, which goes on straight beyond the first and last of them."""
    if len(known) < 2:
        return np.full(len(s), values.sum())
    after = np.clip(np.searchsorted(known, s), 1, len(known) - 1)
    step = known[after] - known[after - 1]
    # points of the smallest facets may have one place, to rounding
    part = np.divide(s - known[after - 1], step, out=np.zeros(len(s)), where=step > 0.0)
    return (1.0 - part) * values[after - 1] + part * values[after]
