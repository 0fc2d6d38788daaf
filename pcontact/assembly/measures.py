"""Stretch and rotation of bodies, cell by cell, for reports and pictures.

Compiled kernel that says how far bodies with small strain are from what small strain represents.

With the displacement gradient H at a place in a cell, small strain e = sym H and w = skew H, the logarithmic strain is

    e + q - 1/2 e e,   q = 1/2 (-w w + e w - w e)

up to terms of the third order.

What small strain leaves out makes, with the stress s = C e, the potential of a motion x u, along which the bodies give
way by x^2 v, differ from the quadratic one by (Koiter's expansion, of a structure)

    x^3 <s, q> + x^4 1/2 <C (e(v) + q), e(v) + q>

where v, zero on supports, makes the last term least: what is left of it are the membrane forces of plates and beams.
The displacement v answers the forces  - <C q, e(.)>  with the tangent.  The force along u is the derivative: at x = 1
it differs from <s, e> by  3 <s, q> + 2 <C (e(v) + q), e(v) + q>.  The part of a body among others in the first sum
is <s, q + e(v)> less the work of the loads along v: for all of them together <s, e(v)> is that work, and a body that
turns together with all that it touches has e(v) = -q. The term - 1/2 e e is another matter, of the strain alone: the
force changes by  3 <s, - 1/2 e e>  of all bodies, which may make up for what rotations do, as it does where bodies are
pressed into each other.
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.geometry import chunks, hoop, points_of
from pcontact.assembly.item import Sum
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, shape, shape_gradient
from pcontact.material.elastic import HALF, indices
from pcontact.material.hardening import RADIUS
from pcontact.material.log_strain import compose, eigenpairs, twice_green
from pcontact.runtime.jit import njit, njit_inline
from pcontact.runtime.petsc import MPI

# sums of `add_distortion`, one after the other
VOLUME, WORK, STRAIN, TURN, TURN_WORK, STIFFENING, MEMBRANE, STRETCH = range(8)
SUMS = 8


class Places(NamedTuple):
    """Cells of a block with what takes nodes to one place in each of them.

    Attributes
    ----------
    places : ndarray (n, d)
        Of the nodes of the geometry [length].
    table : ndarray (nc, ng)
        Nodes of the geometry.
    cells : ndarray (nc, nn)
        Nodes of the displacement.
    geo, dgeo : ndarray (ng,), (ng, d)
        Shape functions of the geometry there, and their reference gradients.
    shape, dshape : ndarray (nn,), (nn, d)
        The same of the displacement.
    weight : float
        Volume of the reference cell that the place stands for.
    ring : bool
        Whether x is the radius of an axisymmetric body.
    """

    places: np.ndarray
    table: np.ndarray
    cells: np.ndarray
    geo: np.ndarray
    dgeo: np.ndarray
    shape: np.ndarray
    dshape: np.ndarray
    weight: float
    ring: bool


class Stiffness(NamedTuple):
    """Stiffness of cells, by which a strain stands for work.

    Attributes
    ----------
    lam, mu : float
        Lame constants [stress].
    limit : float
        Size of the strain beyond which stresses do not grow; infinite where nothing yields.
    rest : ndarray (k, 6, 6)
        What an orthotropic stiffness differs by, in Mandel components [stress]: of all cells (k = 1), or of each of
        them; k = 0 of an isotropic one.
    free : ndarray (k, 6)
        Strain of the cells without stress, such as that of heat, in Mandel components; k = 0 without.
    """

    lam: float
    mu: float
    limit: float
    rest: np.ndarray
    free: np.ndarray


@njit_inline
def _gradient(centres, nodal, c, inverse, scale, out):
    """Displacement gradient (3, 3) of a cell; returns its radial displacement."""
    cells, dshape = centres.cells, centres.dshape
    d, across = nodal.shape[1], 0.0
    out[:, :] = 0.0
    for a in range(cells.shape[1]):
        node = cells[c, a]
        across += centres.shape[a] * nodal[node, 0]
        for k in range(d):
            slope = 0.0
            for j in range(d):
                slope += dshape[a, j] * inverse[j, k] * scale
            for i in range(d):
                out[i, k] += nodal[node, i] * slope
    return across


@njit_inline
def _mandel(h, out):
    """Symmetric part of a matrix (3, 3) in Mandel components."""
    out[0], out[1], out[2] = h[0, 0], h[1, 1], h[2, 2]
    out[3], out[4], out[5] = HALF * (h[0, 1] + h[1, 0]), HALF * (h[1, 2] + h[2, 1]), HALF * (h[0, 2] + h[2, 0])


@njit_inline
def _stress(stiffness, c, strain, out):
    """Stress of a strain in a cell, both in Mandel components."""
    lam, mu, rest = stiffness.lam, stiffness.mu, stiffness.rest
    pressure = lam * (strain[0] + strain[1] + strain[2])
    for i in range(6):
        out[i] = 2.0 * mu * strain[i] + (pressure if i < 3 else 0.0)
    if len(rest) > 0:
        for i in range(6):
            for j in range(6):
                out[i] += rest[c if len(rest) > 1 else 0, i, j] * strain[j]


@njit_inline
def _add_force(centres, c, stress, volume, inverse, scale, radius, out):
    """Add the nodal forces of a stress in a cell, in Mandel components."""
    cells, dshape, d = centres.cells, centres.dshape, out.shape[1]
    slope = np.zeros(3)
    for a in range(cells.shape[1]):
        node = cells[c, a]
        for k in range(d):
            slope[k] = 0.0
            for j in range(d):
                slope[k] += dshape[a, j] * inverse[j, k] * scale
        out[node, 0] += volume * (stress[0] * slope[0] + HALF * (stress[3] * slope[1] + stress[5] * slope[2]))
        out[node, 1] += volume * (stress[1] * slope[1] + HALF * (stress[3] * slope[0] + stress[4] * slope[2]))
        if d == 3:
            out[node, 2] += volume * (stress[2] * slope[2] + HALF * (stress[4] * slope[1] + stress[5] * slope[0]))
        if centres.ring:
            out[node, 0] += volume * stress[2] * centres.shape[a] / radius


@njit
def add_distortion(centres, nodal, second, stiffness, sums, largest, forces):
    """Add what the cells of a block say of small strain to ``sums``.

    Parameters
    ----------
    centres : Places
    nodal : ndarray (n, d)
        Displacement u [length].
    second : ndarray (n, d)
        Displacement v by which bodies give way to q [length]; n = 0: zero.
    stiffness : Stiffness
    sums : ndarray (8,)
        Integrals of 1, of the work density W = s : e, of W |e|, |w|^2, W |w|^2, of s : (e(v) + q), of
        1/2 C (e(v) + q) : (e(v) + q), and of -1/2 s : (e e).
    largest : ndarray (2,)
        Overwritten: largest of the errors |e| / 2 and |w|^2 / 2 of a cell, and its number; -1, -1 without cells.
    forces : ndarray (n, d)
        The nodal forces of the stress C q are added [force]; n = 0: they are not wanted.
    """
    places, table, dgeo = centres.places, centres.table, centres.dgeo
    d, free = nodal.shape[1], stiffness.free
    strain, stress, beyond, more, square = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6)
    jacobian, inverse = np.zeros((3, 3)), np.zeros((3, 3))
    h, q, twice = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    largest[:] = -1.0
    for c in range(centres.cells.shape[0]):
        jacobian[:, :] = 0.0
        jacobian[2, 2] = 1.0 if d == 2 else 0.0
        radius = 0.0
        for a in range(table.shape[1]):
            node = table[c, a]
            radius += centres.geo[a] * places[node, 0]
            for i in range(d):
                for j in range(d):
                    jacobian[i, j] += places[node, i] * dgeo[a, j]
        for i in range(3):
            k, m = (i + 1) % 3, (i + 2) % 3
            for j in range(3):
                p, r = (j + 1) % 3, (j + 2) % 3
                inverse[j, i] = jacobian[k, p] * jacobian[m, r] - jacobian[k, r] * jacobian[m, p]
        det = jacobian[0, 0] * inverse[0, 0] + jacobian[0, 1] * inverse[1, 0] + jacobian[0, 2] * inverse[2, 0]
        scale = 1.0 / det
        across = _gradient(centres, nodal, c, inverse, scale, h)
        volume = centres.weight * det
        if centres.ring:
            h[2, 2] = across / radius
            volume *= 2.0 * np.pi * radius
        # H^T H - e e has the symmetric part  -w w + e w - w e
        for i in range(3):
            for j in range(3):
                q[i, j], twice[i, j] = 0.0, 0.0
                for k in range(3):
                    q[i, j] += 0.5 * h[k, i] * h[k, j]
                    twice[i, j] += 0.25 * (h[i, k] + h[k, i]) * (h[k, j] + h[j, k])
                q[i, j] -= 0.5 * twice[i, j]
        _mandel(h, strain)
        _mandel(q, beyond)
        _mandel(twice, square)
        if len(free) > 0:
            for i in range(6):
                strain[i] -= free[c, i]
        _stress(stiffness, c, strain, stress)
        turn, size, work = 0.0, 0.0, 0.0
        for i in range(3):
            j = (i + 1) % 3
            turn += 0.25 * (h[i, j] - h[j, i]) ** 2
        for i in range(6):
            size += strain[i] * strain[i]
            work += stress[i] * strain[i]
        size = np.sqrt(size)
        part = volume if size <= stiffness.limit else volume * stiffness.limit / size
        work *= part
        if len(forces) > 0:
            _stress(stiffness, c, beyond, more)
            _add_force(centres, c, more, part, inverse, scale, radius, forces)
        if len(second) > 0:
            across = _gradient(centres, second, c, inverse, scale, h)
            if centres.ring:
                h[2, 2] = across / radius
            _mandel(h, more)
            for i in range(6):
                beyond[i] += more[i]
        _stress(stiffness, c, beyond, more)
        sums[VOLUME] += volume
        sums[WORK] += work
        sums[STRAIN] += work * size
        sums[TURN] += volume * turn
        sums[TURN_WORK] += work * turn
        for i in range(6):
            sums[STIFFENING] += part * stress[i] * beyond[i]
            sums[MEMBRANE] += 0.5 * part * more[i] * beyond[i]
            sums[STRETCH] -= 0.5 * part * stress[i] * square[i]
        error = 0.5 * max(size, turn)
        if error > largest[0]:
            largest[0], largest[1] = error, c


# [-] Bound of the stiffening from which on it is worth a linear solve. From: half of what a run says (observers.py).
WORTH = 0.01
# [-] So many times the bound of the last linear solve, or the inverse, is worth another one. From: chosen; between them
# the part of the bound that bodies do not give way to is nearly the same, as q grows with the square of a motion.
AGAIN = 2.0
# [-] Part of q that may be left of e(v) + q without a word. From: chosen; a strain of 1e-6 of one of 1e-2.
LEFT = 1e-4
# [-] Part of the work of all bodies that is none in one of them. From: a thousandth of the strain.
NO_WORK = 1e-6


class Distortion(NamedTuple):
    """Of one body.

    Attributes
    ----------
    strain : float
        Mean size of the strain, sqrt(e : e), by the work that it takes.
    rotation : float
        Root of the mean square, by volume or by that work, whichever is larger [degrees].
    stiffening : float
        Size of the relative change of the forces by the strains that rotations make and bodies do not give way to; no
        more than that where it is less than `WORTH`.
    place : tuple of float
        Reference position where the strain or the rotation is largest [length].
    stretching : float
        Size of the relative change of the forces by the strain alone.
    """

    strain: float
    rotation: float
    stiffening: float
    place: tuple
    stretching: float

    @property
    def errors(self):
        """Parts by which strain, rotation, the rotation against the strain, and the strain's square put results wrong,
        about."""
        return 0.5 * self.strain, 0.5 * np.radians(self.rotation) ** 2, self.stiffening, self.stretching


def _places(space, number, every=False):
    """Places in the cells of a block, one after the other: the centre where the displacement is of degree 1, unless
    `every` one is wanted; of degree 2 the strain of a single cell across a body bends it, and is none at the centre."""
    mesh, block = space.mesh, space.mesh.blocks[number]
    table, degree = mesh.geometry_nodes(block)
    points, weights = quadrature(block.cell, 2 * space.degree if every else space.degree)
    if space.degree == 1 and not every:
        points, weights = (weights @ points / weights.sum())[None, :], weights.sum(keepdims=True)
    for xi, weight in zip(points[:, None, :], weights, strict=True):
        yield Places(
            mesh.points, table, space.cells[number],
            shape(block.cell, degree, xi)[0], np.ascontiguousarray(shape_gradient(block.cell, degree, xi)[0]),
            shape(block.cell, space.degree, xi)[0],
            np.ascontiguousarray(shape_gradient(block.cell, space.degree, xi)[0]),
            float(weight), space.axisymmetric,
        )  # fmt: skip


def _stiffness(bulk, number, centres):
    """:class:`Stiffness` of the cells of a block at a place of each."""
    body = bulk.space.mesh.blocks[number].body
    (lam, mu), law = bulk.constants[body], bulk.materials[body]
    some = centres.table[:1] if law.uniform else centres.table
    x, rest, free = np.einsum("a,cad->cd", centres.geo, centres.places[some]), np.zeros((0, 6, 6)), np.zeros((0, 6))
    if law.anisotropic:
        deviation = law.deviation(x)
        rest = np.zeros((len(deviation), 6, 6))
        rest[:, : law.size, : law.size] = deviation
    if bulk.heat is not None and bulk.heat.heated(number):
        moduli = law.stiffness(x)
        size, stress = moduli.shape[1], bulk.heat.means[number] * [1.0, 1.0, 1.0, *[1.0 / HALF] * 3]
        free = np.zeros_like(stress)
        free[:, :size] = (np.linalg.pinv(moduli) @ stress[:, :size, None])[:, :, 0]
    return Stiffness(lam, mu, RADIUS * law.limit / (2.0 * mu), rest, free)


def _sums(bulk, nodal, second, forces):
    """Sums (n, 8) of :func:`add_distortion` over the bodies, on all ranks, and where each is worst, on this one; with a
    second displacement the work is that of all points of cells of degree 1. *Collective.*"""
    space, of = bulk.space, np.zeros((len(bulk.constants), SUMS))
    largest, none = [(-1.0, ())] * len(of), np.zeros((0, space.dim))
    for number, block in enumerate(space.mesh.blocks):
        if bulk.constants[block.body][1] == 0.0:
            continue
        moved, worst, own, again = bulk.moved(nodal, number), np.zeros(2), of[block.body], np.zeros(SUMS)
        for at in _places(space, number):
            add_distortion(at, moved, second, _stiffness(bulk, number, at), again, worst, forces)
            if worst[0] >= 0.0:
                place = at.geo @ at.places[at.table[int(worst[1])]]
                largest[block.body] = max(largest[block.body], (float(worst[0]), tuple(place.tolist())))
        if len(second) and space.degree == 1 and not (CELLS[block.cell].is_simplex or space.averages(block)):
            # single cells across a body that is bent have no strain in the middle
            every = np.zeros(SUMS)
            for at in _places(space, number, True):
                add_distortion(at, moved, none, _stiffness(bulk, number, at), every, worst, none)
            again[WORK] = every[WORK]
        own += again
    return space.comm.allreduce(of, op=MPI.SUM), largest


class Relief:
    """What bodies give way to.

    Parameters
    ----------
    answer : callable
        From a displacement, a vector, and forces (n_owned, d) to the displacement, a vector, that answers them there,
        and the loads (n_owned, d); None where that is not known.
    n_bodies : int

    Attributes
    ----------
    sums : list of pcontact.assembly.viscous.Sum
        What a restarted run goes on with: the largest bound of the last linear solve, 0 before, and of every body, and
        of all together, the part of the bound that they did not give way to.
    """

    def __init__(self, answer, n_bodies):
        self.answer, self.sums = answer, [Sum() for _ in range(2 + n_bodies)]

    def __call__(self, bound, find):
        """Return the stiffening (n,) of bodies of which a bound is known, the last one that of all together with its
        sign; `find()` says what it is. *Collective.*"""
        most, asked = float(bound.max()), self.sums[0].carried
        if not asked / AGAIN <= most <= asked * AGAIN:
            parts = find() / np.maximum(bound, 1e-300)
            for one, number in zip(self.sums, (most, *parts), strict=True):
                one.carried = float(number)
        return bound * [one.carried for one in self.sums[1:]]


def distortions(bulk, u, held, relief=None):
    """Of all bodies with small strain. *Collective.*

    Parameters
    ----------
    bulk : pcontact.assembly.solid.Solid
        Bodies without stiffness in it are left out: another item has them.
    u : PETSc.Vec
    held : ndarray (n_components,) of bool
        Connected components that a support holds: if nothing more is known, what stiffens others lets them go.
    relief : Relief, optional

    Returns
    -------
    dict of int to Distortion
        By body of the scene, the same on every rank.
    """
    space, comm = bulk.space, bulk.space.comm
    nodal, none = space.local.gather(u), np.zeros((0, space.dim))
    sums, largest = _sums(bulk, nodal, none, none)
    # whatever the bodies give way to: no more than that
    bound = (3.0 * np.abs(sums[:, STIFFENING]) + 4.0 * sums[:, MEMBRANE]) / _work(sums)
    if np.all(bound <= WORTH):
        stiffening, change = bound, 0.0
    elif relief is None:
        *stiffening, change = _unrelieved(bulk, held, sums)
    elif np.all(4.0 * sums[:, MEMBRANE] <= WORTH * _work(sums)):
        # what they give way to changes how the first sum is shared, and not the sum of all
        *stiffening, change = _changes(sums[:, STIFFENING], sums[:, MEMBRANE], sums)
    else:
        bound = np.append(bound, bound.max())
        *stiffening, change = relief(bound, lambda: _stiffening(bulk, u, held, relief.answer, sums))
    alone = 3.0 * sums[:, STRETCH]
    total = float(alone.sum()) / max(float(sums[:, WORK].sum()), 1e-300)
    stretching = min(abs(total), abs(total + change)) * np.abs(alone) / max(float(np.abs(alone).max()), 1e-300)
    places = [max(found)[1] for found in zip(*comm.allgather(largest), strict=True)]
    # bodies that are absent have no cells
    return {body: _of(sums[body], float(stiffening[body]), places[body], float(stretching[body]))
            for body in range(len(sums)) if sums[body][VOLUME] > 0.0}  # fmt: skip


def _work(sums):
    """Work (n_bodies,) of the bodies, to divide by."""
    return np.maximum(sums[:, WORK], max(NO_WORK * float(sums[:, WORK].sum()), 1e-300))


def _unrelieved(bulk, held, sums):
    """Relative change of forces of which nothing is known that bodies give way to: (n_bodies + 1,), see
    :func:`_stiffening`. *Collective.*"""
    stays = np.zeros(len(sums))
    for block in bulk.space.mesh.blocks:
        stays[block.body] += np.count_nonzero(held[block.components])
    stays = bulk.space.comm.allreduce(stays, op=MPI.SUM) > 0
    return np.append(np.where(stays, 3.0 * np.abs(sums[:, STIFFENING]) / _work(sums), 0.0), 0.0)


def _stiffening(bulk, u, held, answers, sums):
    """Relative change of forces, with what the bodies give way to: its size of each, and that of all together with its
    sign (n_bodies + 1,). *Collective.*"""
    space, comm, nodal = bulk.space, bulk.space.comm, bulk.space.local.gather(u)
    forces, none = np.zeros((space.n_local, space.dim)), np.zeros((0, space.dim))
    _sums(bulk, nodal, none, forces)
    answer = answers(u, -space.summed(space.local, forces))
    if answer is None:
        return _unrelieved(bulk, held, sums)
    second = space.local.gather(answer[0])
    after, _ = _sums(bulk, nodal, second, none)
    body = np.zeros(space.n_local, dtype=np.int64)
    for block, cells in zip(space.mesh.blocks, space.cells, strict=True):
        body[cells] = block.body
    taken = np.sum(answer[1] * second[space.owned_local], axis=1)
    loads = np.bincount(body[space.owned_local], taken, len(sums))
    first, membrane = after[:, STIFFENING] - comm.allreduce(loads, op=MPI.SUM), after[:, MEMBRANE]
    # where next to nothing is left of q, that is what the linear solve has left
    first[np.abs(first) < LEFT * np.sqrt(2.0 * np.maximum(sums[:, MEMBRANE] * after[:, WORK], 0.0))] = 0.0
    membrane[membrane < LEFT**2 * sums[:, MEMBRANE]] = 0.0
    return _changes(first, membrane, after)


def _changes(first, membrane, sums):
    """Relative change of forces (n_bodies + 1,), see :func:`_stiffening`, by both integrals of the bodies."""
    # what all bodies resist changes by the sum of the parts, and is said of those that make it, but for what strain
    # alone does against it; it may be little although a body that does little of the work has a membrane force
    parts, work = 3.0 * first + 4.0 * membrane, max(float(sums[:, WORK].sum()), 1e-300)
    change = min(abs(float(parts.sum())), abs(float(parts.sum() + 3.0 * sums[:, STRETCH].sum()))) / work
    share = np.abs(parts) / max(float(np.abs(parts).max()), 1e-300)
    own = np.maximum(change * share, np.minimum(np.abs(parts), 4.0 * membrane) / _work(sums))
    return np.append(own, float(parts.sum()) / work)


def _of(sums, stiffening, place, stretching):
    work, volume = max(sums[WORK], 1e-300), max(sums[VOLUME], 1e-300)
    rotation = np.degrees(np.sqrt(max(sums[TURN] / volume, sums[TURN_WORK] / work)))
    return Distortion(float(sums[STRAIN] / work), float(rotation), stiffening, place, stretching)


# [-] sine of an angle below which the axis of a turn by about 180 degrees is that of the largest diagonal entry. From:
# chosen; the axial vector has lost four digits there.
FLAT = 1e-4


@njit
def principal_stretches(strain, m, out):
    """exp of the principal values of logarithmic strains (nc, 6) into ``out`` (nc, 3), the largest first.

    With m = 4 the third direction stands alone. Components XX, YY, ZZ, XY, YZ, XZ of the tensors.
    """
    tensor, values, vectors = np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3))
    for c in range(len(strain)):
        for k in range(6):
            i, j = indices(k)
            tensor[i, j] = strain[c, k]
            tensor[j, i] = strain[c, k]
        eigenpairs(tensor, m, values, vectors)
        values.sort()
        for i in range(3):
            out[c, i] = np.exp(values[2 - i])


@njit
def rotation_vectors(h, m, out):
    """Rotation vectors [degrees] of displacement gradients.

    Parameters
    ----------
    h : ndarray (nc, 3, 3)
    m : int
        6; 4 where the third direction stands alone.
    out : ndarray (nc, 3)
        Overwritten: axis times angle, at most 180 degrees, of the rotation R of F = R U.
    """
    twice, root, values, vectors = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3))
    r = np.zeros((3, 3))
    for c in range(len(h)):
        twice_green(h[c], twice)
        eigenpairs(twice, m, values, vectors)
        for i in range(3):
            values[i] = 1.0 / np.sqrt(1.0 + values[i])
        compose(values, vectors, root)
        for i in range(3):
            for j in range(3):
                r[i, j] = root[i, j]
                for k in range(3):
                    r[i, j] += h[c, i, k] * root[k, j]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            out[c, i] = 0.5 * (r[k, j] - r[j, k])
        sine = np.sqrt(out[c, 0] ** 2 + out[c, 1] ** 2 + out[c, 2] ** 2)
        cosine = 0.5 * (r[0, 0] + r[1, 1] + r[2, 2] - 1.0)
        angle = np.degrees(np.arctan2(sine, cosine))
        if cosine < 0.0 and sine < FLAT:
            # 1/2 (R + R^T) = cos I + (1 - cos) a a, with the axis a
            most = np.argmax(np.diag(r))
            sign = -1.0 if out[c, most] < 0.0 else 1.0
            for i in range(3):
                values[i] = 0.5 * (r[i, most] + r[most, i]) - (cosine if i == most else 0.0)
            length = np.sqrt(values[0] ** 2 + values[1] ** 2 + values[2] ** 2)
            for i in range(3):
                out[c, i] = sign * angle * values[i] / length
        elif sine > 0.0:
            for i in range(3):
                out[c, i] *= angle / sine


def mean_gradients(space, nodal, number):
    """Mean displacement gradient (nc, 3, 3) over every undeformed cell of a block, of nodal values (n, d)."""
    d, cells = space.dim, space.cells[number]
    result = np.zeros((len(cells), 3, 3))
    for rows, grad, jxw, shapes in chunks(space, number):
        values, weight = nodal[cells[rows]], jxw / jxw.sum(axis=1)[:, None]
        result[rows, :d, :d] = np.einsum("cq,cqaj,cai->cij", weight, grad, values, optimize=True)
        ring = hoop(space, number, rows, shapes)
        if ring is not None:
            result[rows, 2, 2] = np.einsum("cq,cqa,ca->c", weight, ring, values[:, :, 0])
    return result


def deformation_fields(space, nodal, strains):
    """Fields of cells: logarithmic strain, principal stretches, rotation vector.

    Parameters
    ----------
    space : pcontact.space.space.Space
    nodal : ndarray (n, d)
        Displacement of local nodes [length].
    strains : list of ndarray (nc, 6)
        Mean logarithmic strain of the cells of each block.

    Returns
    -------
    dict of str to list of ndarray
        ``log_strain``; ``stretch_1`` >= ``stretch_2`` >= ``stretch_3`` (nc,), exp of its principal values; ``rotation``
        (nc, 3), of the mean displacement gradient [degrees].
    """
    m, result = 6 if space.dim == 3 else 4, {"log_strain": strains}
    stretches = [np.zeros((len(strain), 3)) for strain in strains]
    for strain, out in zip(strains, stretches, strict=True):
        principal_stretches(strain, m, out)
    for k in range(3):
        result[f"stretch_{k + 1}"] = [np.ascontiguousarray(out[:, k]) for out in stretches]
    result["rotation"] = [np.zeros((len(strain), 3)) for strain in strains]
    for number, out in enumerate(result["rotation"]):
        rotation_vectors(mean_gradients(space, nodal, number), m, out)
    return result


class Deformation(NamedTuple):
    """Of one body, by the means over its cells.

    Attributes
    ----------
    largest_stretch, smallest_stretch : float
    rotation : float
        Largest angle [degrees].
    place : tuple of float
        Middle, in the undeformed body, of the cell whose stretch is farthest from 1 [length].
    """

    largest_stretch: float
    smallest_stretch: float
    rotation: float
    place: tuple


def deformations(space, fields, numbers):
    """Largest stretches and rotations of bodies. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    fields : dict of str to list of ndarray
        See :func:`deformation_fields`.
    numbers : iterable of int
        Blocks.

    Returns
    -------
    dict of int to Deformation
        By body of the scene, the same on every rank.
    """
    own = {}
    for number in numbers:
        high, low = fields["stretch_1"][number], fields["stretch_3"][number]
        if len(high) == 0:
            continue
        far = np.maximum(high, 1.0 / low)
        cell = int(np.argmax(far))
        place = points_of(space, number, slice(cell, cell + 1))[0].mean(axis=0)
        turned = np.linalg.norm(fields["rotation"][number], axis=1)
        found = high.max(), -low.min(), turned.max(), (far[cell], tuple(place.tolist()))
        body = space.mesh.blocks[number].body
        own[body] = [max(pair) for pair in zip(own.get(body, found), found, strict=True)]
    every = space.comm.allgather(own)
    result = {}
    for body in sorted(set().union(*every)):
        high, low, turn, far = (max(parts) for parts in zip(*(one[body] for one in every if body in one), strict=True))
        result[body] = Deformation(float(high), float(-low), float(turn), far[1])
    return result
