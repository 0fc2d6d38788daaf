"""Finite strain in plain tensors, and small meshes of it."""

import numpy as np

from pcontact.assembly.finite import FiniteSolid
from pcontact.material.elastic import elastic_stress, in_plane, lame
from pcontact.material.finite import FiniteMaterial
from pcontact.material.hardening import hardening_curve
from pcontact.material.plastic import VonMises, plastic_constants, return_map
from pcontact.mesh.read import read_mesh
from pcontact.space.space import Space
from tests.support.plastic import mandel, tensor
from tests.support.small import SELF, bend, block_file, make_space, vector_of

YOUNG, POISSON, YIELD, SLOPE, PRAGER = 200.0, 0.3, 5.0, 20.0, 15.0
LAM, MU = lame(YOUNG, POISSON)
NONE, HENCKY = np.zeros((0, 3)), np.zeros((0, 2))


def finite_material(name, plane_stress=False):
    """A material by name; the yield stress is small enough for random states to yield."""
    curve, terms, back, multiplicative = NONE, HENCKY, 0.0, True
    if name in ("multiplicative", "additive", "prager"):
        curve, multiplicative = hardening_curve(YIELD, SLOPE), name == "multiplicative"
        back = PRAGER if name == "prager" else 0.0
    elif name == "perfect":
        curve = hardening_curve(YIELD)
    elif name == "neo_hooke":
        terms = np.array([[MU, 2.0]])
    elif name == "mooney_rivlin":
        terms = np.array([[0.7 * MU, 2.0], [-0.3 * MU, -2.0]])
    elif name == "ogden":
        terms = np.array([[0.5 * MU, 1.3], [0.1 * MU, 5.0], [-0.425 * MU, -2.0]])
    own = LAM + 2.0 / 3.0 * MU if len(terms) else LAM
    return FiniteMaterial(
        VonMises(plastic_constants(LAM, MU, back), curve, plane_stress), terms, multiplicative, own, 0.0
    )


LAWS = ["hencky", "multiplicative", "additive", "prager", "neo_hooke", "mooney_rivlin", "ogden"]


def function_of(a, f):
    """f of a symmetric matrix, by numpy's eigenvectors."""
    values, vectors = np.linalg.eigh(a)
    return (vectors * f(values)) @ vectors.T


def rubber_stress(terms, bulk, c):
    """S of rubber, of the principal stretches."""
    values, vectors = np.linalg.eigh(c)
    volume, t = np.sqrt(np.prod(values)), np.zeros(3)
    for mu, alpha in terms:
        stretched = (np.sqrt(values) / volume ** (1.0 / 3.0)) ** alpha
        t += mu * (stretched - stretched.mean())
    return (vectors * ((t + 0.5 * bulk * (volume**2 - 1.0)) / values)) @ vectors.T


def twin(material, gradient, plastic, p, m):
    """S, Ui, the new plastic strain, all (3, 3), and the new p of a point, by numpy's eigenvectors of C.

    The law of small strain is asked in the axes of the mesh.
    """
    if len(material.terms):
        return rubber_stress(material.terms, material.own, gradient.T @ gradient), np.eye(3), plastic, p
    ui = function_of(plastic, lambda e: np.exp(-e)) if material.multiplicative else np.eye(3)
    c = (gradient @ ui).T @ (gradient @ ui)
    strain, before = mandel(0.5 * function_of(c, np.log), m), mandel(plastic, m)
    start = np.zeros(m) if material.multiplicative else before
    stress, new, excess = np.zeros(m), start.copy(), np.zeros(m)
    elastic_stress(material.small.constants, material.small.plane_stress, strain, stress)
    if material.yields:
        p, _ = return_map(material.small, strain, start, p, False, new, excess, np.zeros((m, m)))
    values, vectors = np.linalg.eigh(c)
    turned, f = vectors.T @ tensor(stress + excess) @ vectors, np.diag(1.0 / values)
    for i, j in ((0, 1), (1, 2), (0, 2)):
        f[i, j] = f[j, i] = np.log(values[i] / values[j]) / (values[i] - values[j])
    new = tensor(new)
    if material.multiplicative:
        up = function_of(plastic, np.exp)
        new = 0.5 * function_of(up @ function_of(2.0 * new, np.exp) @ up, np.log)
    return vectors @ (f * turned) @ vectors.T, ui, new, p


def finite_space(mesh, degree, kinematics, averaged):
    """A space on a mesh whose body takes its mean dilatation, or not."""
    bodies = [0] if averaged else []
    return Space(mesh, degree, kinematics, bodies, bodies if degree == 2 else [])


def finite_bulk(space, law):
    """The item of one body with finite strain."""
    material = finite_material(law, space.kinematics == "plane_stress")
    return FiniteSolid(space, [in_plane(LAM, MU, space.kinematics)], [material])


def finite_grid(folder, cell, degree):
    """Mesh of a bent block, off the axis of symmetry, on one rank."""
    file = block_file(folder / f"{cell}{degree}.msh", cell, 1 if degree == 2 else 2)
    space = make_space(SELF, file, list(read_mesh(file).cell_groups)[:1], degree, lambda x: bend(x) + 1.0)
    return space.mesh


def deformed(space, rng):
    """A displacement (n_local, d) of large strain, of which no cell is turned inside out."""
    gradient = 0.15 * rng.standard_normal((space.dim, space.dim))
    return space.points @ gradient.T + 0.01 * rng.standard_normal(space.points.shape)


def history(bulk, rng):
    """The item after two steps along different ways."""
    for _ in range(2):
        bulk.commit(vector_of(bulk.space, deformed(bulk.space, rng)[bulk.space.owned_local]), 0.0)
    return bulk


def forces_of(item, u):
    """Forces (n_owned, d) at a displacement (n_owned, d)."""
    out = np.zeros(u.shape)
    item.residual(vector_of(item.space, u), out)
    return out
