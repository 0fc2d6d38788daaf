"""Plasticity in plain tensors; bars and pairs of bodies that yield."""

import numpy as np
import pytest

from meshes.blocks import one_block
from pcontact.assembly.solid import Solid
from pcontact.contact.pair import contact_pair
from pcontact.contact.surface.obstacle import RigidObstacle
from pcontact.contact.surface.sides import source_surface, target_surface
from pcontact.material.elastic import Elastic, add_elastic_tangent, elastic_stress, lame
from pcontact.material.hardening import hardening_curve, hardening_table
from pcontact.material.plastic import Plastic, VonMises, flows, plastic_constants, return_map
from pcontact.scene.amplitude import amplitude
from pcontact.scene.model import Body, Displacement, Load, Material, MeshSpec, Output, Scene, Steps
from tests.support.kinematics import DIRECT, mesh
from tests.support.pairs import farthest, phases, residual_of
from tests.support.small import dense_item, vector_of

YOUNG, POISSON, YIELD = 200.0, 0.3, 0.5
YIELD_STRAIN = YIELD / YOUNG
LAME = lame(YOUNG, POISSON)
# the last segments are steeper than those before: the curve is not concave
TABLE = [[0.0, YIELD], [0.002, 0.6], [0.005, 0.65], [0.01, 1.1], [0.02, 1.15]]
CURVES = {
    "perfect": hardening_curve(YIELD),
    "linear": hardening_curve(YIELD, 20.0),
    "stiff": hardening_curve(YIELD, 5e3),
    "table": hardening_table(TABLE),
}
KINEMATIC = {"": 0.0, "+kinematic": 15.0}
MATERIALS = {a + b: (plastic_constants(*LAME, KINEMATIC[b]), CURVES[a]) for a in CURVES for b in KINEMATIC}
ROOT = np.sqrt(2.0)
PAIRS = {6: [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)], 4: [(0, 0), (1, 1), (2, 2), (0, 1)]}


def tensor(v):
    """Tensor (3, 3) of Mandel components."""
    t = np.zeros((3, 3))
    for value, (i, j) in zip(v, PAIRS[len(v)], strict=True):
        t[i, j] = t[j, i] = value if i == j else value / ROOT
    return t


def mandel(t, m):
    return np.array([t[i, j] * (1.0 if i == j else ROOT) for i, j in PAIRS[m]])


class Point:
    """One point: ``move`` gives stress and tangent of a strain and keeps its result as the new state."""

    def __init__(self, material, mode, plastic=None, p=0.0):
        row, curve = MATERIALS[material] if isinstance(material, str) else material
        self.m, self.material = (6 if mode == "3D" else 4), VonMises(row, curve, mode == "plane stress")
        self.plastic, self.p = np.zeros(self.m) if plastic is None else plastic, p

    def raw(self, strain, want_tangent=True):
        plastic, excess, tangent = np.full(self.m, np.inf), np.full(self.m, np.inf), np.zeros((self.m, self.m))
        p, yields = return_map(self.material, strain, self.plastic, self.p, want_tangent, plastic, excess, tangent)
        return excess, plastic, p, yields, tangent

    def stress(self, strain):
        excess = self.raw(strain)[0]
        stress = np.empty(self.m)
        elastic_stress(self.material.constants, self.material.plane_stress, strain, stress)
        return stress + excess

    def tangent(self, strain):
        tangent = self.raw(strain)[4]
        add_elastic_tangent(self.material.constants, self.material.plane_stress, tangent)
        return tangent

    def move(self, strain):
        stress = self.stress(strain)
        _, self.plastic, self.p, yields, _ = self.raw(strain, want_tangent=False)
        return stress, yields

    def flows(self, strain):
        return flows(self.material, strain, self.plastic, self.p, np.empty(self.m))

    def relative(self, stress):
        """Deviator of a stress minus back stress of the state, a tensor."""
        t = tensor(stress)
        return t - np.trace(t) / 3.0 * np.eye(3) - 2.0 / 3.0 * self.material.constants[2] * tensor(self.plastic)


def uniaxial(strains, of_strain, of_plastic, hardening, kinematic):
    """Driving stress, plastic strain, p at the end of each strain: one dimension, of_strain e - of_plastic ep."""
    plastic, p, rows = 0.0, 0.0, []
    for e in strains:
        trial = of_strain * e - (of_plastic + kinematic) * plastic
        over = abs(trial) - (YIELD + hardening * p)
        step = max(over, 0.0) / (of_plastic + hardening + kinematic)
        plastic, p = plastic + step * np.sign(trial), p + step
        rows.append((of_strain * e - of_plastic * plastic, plastic, p))
    return rows


def bar(path, kinematics, n, held, hardening, kinematic, table=None, load=None):
    """A unit box pulled along its last axis at its top, free to contract or ``held`` sideways. Collective."""
    dim = 3 if kinematics == "3D" else 2
    sides = [("left", 0), ("front", 1)][: dim - 1] + ([("right", 0), ("back", 1)][: dim - 1] if held else [])
    supports = [Displacement(name, [0.0 if k == axis else "free" for k in range(dim)]) for name, axis in sides]
    supports.append(Displacement("bottom", [*["free"] * (dim - 1), 0.0]))
    loads = [Load("top", traction=[*[0.0] * (dim - 1), 1.0], amplitude=load)] if load else []
    supports += [Displacement("top", [*["free"] * (dim - 1), 1.0], table)] if table else []
    end = (table or load)[-1][0]
    return Scene(
        mesh=MeshSpec(mesh(one_block, path, dim, n), kinematics="plane_strain" if dim == 3 else kinematics),
        materials={"m": Material(YOUNG, POISSON, YIELD, hardening, kinematic)},
        bodies=[Body("block", "m")],
        displacements=supports,
        loads=loads,
        steps=Steps(end, int(end)),
        output=Output(fields=False),
        petsc={**DIRECT, "snes_rtol": "1e-13"},
    )


BARS = [("plane_stress", False), ("axisymmetric", False), ("3D", False), ("plane_strain", True), ("3D", True)]

SOFT = lame(10.0, 0.3)


def solid(space, constants, materials):
    """The item of bodies with Lame constants, of which those with a material yield."""
    own = space.dim, space.kinematics
    return Solid(space, [Elastic(*constants, own[1]) if one is None else Plastic(*one[0][:2], one[1], one[0][2], *own)
                         for one in materials])  # fmt: skip


def items(space, contact, materials, constants, radius=1.0):
    """Bulk item and pair."""
    bulk = solid(space, constants, materials)
    source = source_surface(space, contact.source, bulk.constants, contact.quadrature)
    if contact.obstacle is None:
        target = target_surface(space, contact.target)
    else:
        target = RigidObstacle(contact.obstacle, amplitude(contact.obstacle.amplitude, 1.0), 1.0)
    return bulk, contact_pair(space, contact, source, target, radius, bulk=bulk)


def flowing(bulk, u):
    """Which points would yield at a displacement; the state stays."""
    before = {number: s.values.copy() for number, s in bulk.states.items()}
    bulk.commit(vector_of(bulk.space, u), 1.0)
    result = np.concatenate([(s.p > s.material.flow(before[number])).ravel() for number, s in bulk.states.items()])
    for number, s in bulk.states.items():
        s.values[:] = before[number]
    return result


def taylor(bulk, item, u, name, directions):
    """|R(u + h v) - R(u) - h K v| over |h K v| for h and its halves; of some v that which goes farthest unchanged."""
    h, v = farthest([lambda moved: phases(item, moved, name), lambda moved: flowing(bulk, moved)], u, directions)
    slope, start = dense_item(item, vector_of(item.space, u)) @ v.ravel(), residual_of(item, u)
    scale, errors = max(np.abs(h * slope).max(), 1e-3 * np.abs(start).max(), 1e-300), []
    for part in h * 0.5 ** np.arange(6, 10):
        change = residual_of(item, u + part * v) - start
        errors.append(np.abs(change - part * slope).max() * h / (scale * part))
    return np.array(errors)


def check(errors):
    """Second order, or nothing but rounding; whether it is the former."""
    if np.all(errors < 1e-9):
        return False
    errors = errors[errors > 1e-9]
    assert len(errors) > 1 and errors[-2] / errors[-1] == pytest.approx(2.0, rel=0.1)
    return True
