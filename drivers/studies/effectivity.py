"""Error estimate over error, in the energy norm, where the error is known.

    rings       two rings in contact, plane strain, Lame's solution (drivers/cases/rings.py)
    tubes       the same in space, hexahedra
    shells      two spherical shells in contact, in space, tetrahedra, Lame's solution for spheres
    cylinder    a thick cylinder under pressure, without contact: in space, and with axial symmetry
    mean        the same with nu = 0.4999 and mean dilatation, in the norm of its energy
    hertz       a cylinder on a block (plane) and a ball on a block (space); the error is that against a solution of
                degree 2 on the mesh whose cells are all halved, with the same straight sides
    hill        a thick cylinder that yields on half of its section, without hardening and with E / 10; the error as
                for Hertz
    indent      a ball pressed into a block that yields and hardens little, with axial symmetry; the error as for Hertz
    blocks      one on the other, pressed and sheared, singular at the corners: Coulomb and Tresca friction, unbiased
                contact, tied surfaces, a target 1000 times as stiff, laminates whose fibres lie at +30 and -50 degrees,
                with friction; the lower one of degree 1 in a mesh of degree 2, with friction, and with shared nodes
                (joined; die: 1000 times as stiff); the error as for Hertz
    wound       two orthotropic rings in contact, plane strain, a laminate that is wound around one of wood
                (Lekhnitskii 1963); a thick cylinder of the laminate in space, with axial symmetry
    loads       a block that is held on its left side, under its weight, the force of a turn about an axis, a total
                force and moment, a temperature with a hot spot; on stiff springs; moved by a group that is rigid, or
                moves so on average; the error as for Hertz

A case, a degree and a theta take one row per mesh. The cells of the round cases are curved (degree 2), but for Hertz.
"""

from argparse import Namespace
from functools import partial

import gmsh
import numpy as np

from drivers._common import draw, log, main, make_mesh, make_parser, observed_rates, print_table, running, write_json
from drivers.cases import hertz, indent, rings, thick_cylinder
from meshes import indent as indent_mesh
from meshes import one_block, two_blocks
from meshes import rings as ring_mesh
from meshes.shells import shells, tubes
from meshes.tools import finish, gmsh_model, group, unstructured
from pcontact import build
from pcontact.adapt.watch import at_nodes
from pcontact.assembly.bulk import ElasticBulk
from pcontact.assembly.error_norms import bulk_error
from pcontact.material.orthotropic import stiffness
from pcontact.mesh.refinement.refine import Balance, refine
from pcontact.runtime.errors import InputError
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import (
    Body,
    Contact,
    Coupling,
    Displacement,
    Load,
    Material,
    MeshSpec,
    Output,
    Scene,
    Spring,
    Temperature,
)

DIRECT = {"pc_type": "lu", "ksp_type": "preonly", "pc_factor_mat_solver_type": "mumps"}
LARGE, MIDDLE, SMALL = 1.0, 0.6, 0.3
E, NU, PRESSURE = 1e9, 0.2, 1e7
BLOCKS = {
    "friction": {"friction": 0.3},
    "tresca": {"tresca": 0.02},
    "unbiased": {"unbiased": True},
    "tied": {"tied": True},
    "stiff": {},
    "laminate": {"friction": 0.3},
    "lower": {"friction": 0.3},
    "joined": {},
    "die": {},
}
# what the block has beside its held left side, in the plane; see `loaded`
LOADS = ("weight", "spin", "total", "heat", "heat_fibres", "springs", "rigid", "average")
# carbon fibres, and spruce: E, nu, G along axes 1, 2, 3 [GPa]; around an axis along radius, hoop and axis
FIBRES = ([140.0, 10.0, 10.0], [0.3, 0.3, 0.45], [5.0, 5.0, 3.448])
WOUND = ([10.0, 140.0, 10.0], [0.3 / 14.0, 0.45, 0.3], [5.0, 3.448, 5.0])
TRUNK = ([0.8, 0.45, 10.0], [0.47, 0.0296, 0.0189], [0.05, 0.65, 0.6])
# element sizes or numbers of cells, from coarse to fine, those of --tiny first
SIZES = {
    "rings-quadrilateral": (8, 16, 32),
    "rings-triangle": (8, 16, 32),
    "tubes-hexahedron": (4, 8, 12),
    "shells-tetrahedron": (0.2, 0.13, 0.09),
    "cylinder-space-hexahedron": (2, 4, 8),
    "cylinder-space-tetrahedron": (2, 4, 8),
    "cylinder-axisymmetric-quadrilateral": (4, 8, 16),
    "cylinder-axisymmetric-triangle": (4, 8, 16),
    "hertz-cylinder_on_block": (0.4, 0.2, 0.1),
    "hertz-ball_on_block": (0.08, 0.06, 0.045),
    "mean-plane-quadrilateral": (4, 8, 16),
    "mean-plane-triangle": (4, 8, 16),
    "mean-space-hexahedron": (2, 4, 8),
    "mean-space-tetrahedron": (2, 4, 8),
    "hill-perfect": (3, 6, 12),
    "hill-hardening": (3, 6, 12),
    "indent-triangle": (0.15, 0.1, 0.07),
    "wound-rings-triangle": (8, 16, 32),
    "wound-rings-quadrilateral": (8, 16, 32),
    "wound-space-tetrahedron": (2, 4, 8),
    "wound-space-hexahedron": (2, 4, 8),
    "wound-axisymmetric-triangle": (4, 8, 16),
    **{f"blocks-plane-{kind}": (6, 12) for kind in BLOCKS},
    **{f"blocks-space-{kind}": (2, 3) for kind in BLOCKS},
    **{f"loads-plane-{kind}": (6, 12) for kind in LOADS},
    **{f"loads-space-{kind}": (2, 4) for kind in LOADS},
}
TINY = ("rings-triangle", "tubes-hexahedron", "blocks-plane-friction")
# cases that have no theta
ONCE = ("cylinder", "mean", "hill", "indent", "blocks", "wound", "loads")
# cases whose cells lock with degree 1
DEGREE_2 = ("mean-plane-triangle", "mean-space-tetrahedron", "hill-perfect", "hill-hardening", "indent-triangle",
            *(f"blocks-{at}-{kind}" for at in ("plane", "space") for kind in ("lower", "joined", "die")))  # fmt: skip


def _shell(a, b, p_in, p_out):
    """Constants A, B [stress], [stress length^3] of a shell: sigma_rr = A - B / r^3."""
    return (p_in * a**3 - p_out * b**3) / (b**3 - a**3), (p_in - p_out) * (a * b) ** 3 / (b**3 - a**3)


def _stretch(constants, r):
    """Radial displacement over radius."""
    a, b = constants
    return ((1.0 - 2.0 * NU) * a + 0.5 * (1.0 + NU) * b / r**3) / E


def shell_constants():
    """Of the outer and the inner shell, whose contact pressure closes the gap."""
    opened = _stretch(_shell(MIDDLE, LARGE, 0.0, PRESSURE), MIDDLE)
    outer, inner = _stretch(_shell(MIDDLE, LARGE, 1.0, 0.0), MIDDLE), _stretch(_shell(SMALL, MIDDLE, 0.0, 1.0), MIDDLE)
    p = -opened / (outer - inner)
    return _shell(MIDDLE, LARGE, p, PRESSURE), _shell(SMALL, MIDDLE, 0.0, p)


def shell_exact(x, body):
    """Displacement (n, 3) and its gradient (n, 3, 3) at points x (n, 3)."""
    constants, r = shell_constants()[body], np.linalg.norm(x, axis=1)
    value, slope = _stretch(constants, r), -1.5 * (1.0 + NU) * constants[1] / (E * r**5)
    return value[:, None] * x, value[:, None, None] * np.eye(3) + slope[:, None, None] * x[:, :, None] * x[:, None, :]


def in_space(exact):
    """A plane displacement as one in space."""

    def full(x, body):
        u, slope = exact(np.ascontiguousarray(x[:, :2]), body)
        wide = np.zeros((len(x), 3, 3))
        wide[:, :2, :2] = slope
        return np.column_stack([u, np.zeros(len(x))]), wide

    return full


def round_scene(path, degree, theta, title):
    """Two round bodies in space under an outer pressure."""
    sides = [[0.0 if i == k else "free" for i in range(3)] for k in range(3)]
    return Scene(
        title=f"{title}, degree {degree}, theta {theta:g}",
        mesh=MeshSpec(path, order=degree),
        materials={"m": Material(E, NU)},
        bodies=[Body("outer", "m"), Body("inner", "m")],
        contacts=[Contact("inner_outer_skin", "outer_inner_skin", name="round", theta=theta)],
        displacements=[Displacement(f"symmetry_{axis}", side) for axis, side in zip("xyz", sides, strict=True)],
        loads=[Load("outer_skin", pressure=PRESSURE)],
        output=Output(fields=False),
    )


def _cylinder_exact(form, pressure, dim, x, body):
    """Lame's displacement (n, d) and its gradient; with axial symmetry (dim 1) x is the radius."""
    factor = pressure * form.a**2 * (1.0 + form.nu) / (form.E * (form.b**2 - form.a**2))
    plane = 1 if dim == 1 else 2
    r2 = np.sum(x[:, :plane] ** 2, axis=1)
    d = x.shape[1]
    u, slope = np.zeros_like(x), np.zeros((len(x), d, d))
    value = factor * (1.0 - 2.0 * form.nu + form.b**2 / r2)
    u[:, :plane] = value[:, None] * x[:, :plane]
    outer = x[:, :plane, None] * x[:, None, :plane]
    slope[:, :plane, :plane] = value[:, None, None] * np.eye(plane)
    slope[:, :plane, :plane] -= (2.0 * factor * form.b**2 / r2**2)[:, None, None] * outer
    return u, slope


def _powers(constants):
    """Power k of the radial displacement A r^k + B r^-k of an orthotropic ring, and its stiffness (6, 6)."""
    moduli = stiffness(*constants)
    return np.sqrt(moduli[1, 1] / moduli[0, 0]), moduli


def _wound(constants, a, b, p_in, p_out):
    """A and B of a ring with radii a < b under pressures inside and outside."""
    k, moduli = _powers(constants)
    slopes = [[(moduli[0, 0] * n + moduli[0, 1]) * r ** (n - 1.0) for n in (k, -k)] for r in (a, b)]
    return np.linalg.solve(slopes, [-p_in, -p_out])


def _wound_exact(rings, dim, x, body):
    """Displacement (n, d) and its gradient; with axial symmetry (dim 1) x is the radius.

    Parameters
    ----------
    rings : sequence of (tuple, ndarray (2,))
        Constants, A and B of each body.
    dim : int
    x : ndarray (n, d)
    body : int
    """
    constants, (rise, fall) = rings[body]
    k, plane = _powers(constants)[0], 1 if dim == 1 else 2
    r = np.linalg.norm(x[:, :plane], axis=1)
    stretch = rise * r ** (k - 1.0) + fall * r ** (-k - 1.0)
    slope = rise * (k - 1.0) * r ** (k - 3.0) - fall * (k + 1.0) * r ** (-k - 3.0)
    u, full = np.zeros_like(x), np.zeros((len(x), x.shape[1], x.shape[1]))
    u[:, :plane] = stretch[:, None] * x[:, :plane]
    full[:, :plane, :plane] = stretch[:, None, None] * np.eye(plane)
    full[:, :plane, :plane] += slope[:, None, None] * x[:, :plane, None] * x[:, None, :plane]
    return u, full


def wound_rings(path, degree, theta, pressure=1e-2):
    """Scene and exact solution of two orthotropic rings under an outer pressure."""
    middle, kinds = rings.MIDDLE, (WOUND, TRUNK)

    def radial(constants, found, r):
        k = _powers(constants)[0]
        return found[0] * r**k + found[1] * r**-k

    def solutions(p):
        return (_wound(WOUND, middle, rings.LARGE, p, pressure), _wound(TRUNK, rings.SMALL, middle, 0.0, p))

    def gap(p):
        outer, inner = (radial(one, found, middle) for one, found in zip(kinds, solutions(p), strict=True))
        return outer - inner

    known = solutions(-gap(0.0) / (gap(1.0) - gap(0.0)))
    scene = rings.ring_scene(path, degree, theta, pressure=pressure, gamma0=None)
    scene.materials = {name: Material(one[0], one[1], G=one[2], point=[0.0, 0.0])
                       for name, one in zip(("wound", "trunk"), kinds, strict=True)}  # fmt: skip
    scene.bodies = [Body("outer", "wound"), Body("inner", "trunk")]
    return scene, partial(_wound_exact, tuple(zip(kinds, known, strict=True)), 2)


def _wound_cylinder(kinematics, cell, size, degree, folder):
    """Scene and exact solution of a thick cylinder that is wound, under an inner pressure."""
    form = thick_cylinder.Cylinder(10.0, 20.0, 210e3, 0.3, 1e9)
    path = thick_cylinder.make(folder / f"cylinder-{kinematics}-{cell}_{size}.msh", kinematics, cell, 2, size, form)
    scene = thick_cylinder.scene(path, kinematics, degree, [0.1], form, 1, elastic=True)
    (er, eh, ea), (rh, ra, ha), (g_rh, g_ra, g_ha) = WOUND
    more = {"point": [0.0, 0.0, 0.0], "axis": [0.0, 0.0, 1.0]}
    young, poisson, shear = WOUND
    if kinematics == "axisymmetric":
        # axes are radius, axis and hoop there
        young, poisson, shear, more = [er, ea, eh], [ra, rh, ha * ea / eh], [g_ra, g_rh, g_ha], {}
    scene.materials = {name: Material(young, poisson, G=shear, **more) for name in scene.materials}
    known = ((WOUND, _wound(WOUND, form.a, form.b, 0.1, 0.0)),)
    return scene, partial(_wound_exact, known, 1 if kinematics == "axisymmetric" else 3)


def prepare(name, size, degree, theta, folder, finer=False):
    """Scene, mesh and exact solution (None for Hertz) of a case. *Collective.*"""
    kind, _, rest = name.partition("-")
    if kind == "hertz":
        return _hertz(rest, size, degree, theta, folder)
    if kind == "blocks":
        return blocks(*rest.split("-"), size, degree, theta, folder, finer), None
    if kind == "loads":
        return loaded(*rest.split("-"), size, degree, folder), None
    if kind == "wound":
        what, cell = rest.split("-")
        if what != "rings":
            return _wound_cylinder(what, cell, size, degree, folder)
        return wound_rings(make_mesh(ring_mesh, folder / f"rings-{cell}_{size}.msh", n=size, cell=cell, order=2),
                           degree, theta)  # fmt: skip
    if kind == "hill":
        path = thick_cylinder.make(folder / f"{name}_{size}.msh", "plane", "triangle", 2, size)
        law = {"hardening": 0.1 * thick_cylinder.Cylinder().E if rest == "hardening" else 0.0}
        return thick_cylinder.scene(path, "plane", degree, (thick_cylinder.CHECKED,), steps=4, **law), None
    if kind == "indent":
        path = make_mesh(indent_mesh, folder / f"{name}_{size}.msh", 2, size, 2, "triangle")
        metal = indent.metal(hardening=indent.HARDENING)
        return indent.scene(path, 2, material=metal, unload=0, order=degree, steps=10), None
    if kind in ("cylinder", "mean"):
        kinematics, cell = rest.split("-")
        form = thick_cylinder.Cylinder(10.0, 20.0, 210e3, 0.3 if kind == "cylinder" else 0.4999, 1e9)
        path = thick_cylinder.make(folder / f"{name}_{size}.msh", kinematics, cell, 2, size, form)
        scene = thick_cylinder.scene(path, kinematics, degree, [100.0], form, 1, elastic=True)
        dim = {"axisymmetric": 1, "plane": 2, "space": 3}[kinematics]
        if kind == "mean":
            scene.mesh.mean_dilatation = True
            scene.petsc = DIRECT
        return scene, partial(_cylinder_exact, form, 100.0, dim)
    if kind == "rings":
        path = make_mesh(ring_mesh, folder / f"{name}_{size}.msh", n=size, cell=rest, order=2)
        scene = rings.ring_scene(path, degree, theta)
        return scene, partial(rings.exact, constants=rings.ring_constants())
    if kind == "tubes":
        path = make_mesh(tubes, folder / f"{name}_{size}.msh", n=size, order=2)
        exact = partial(rings.exact, constants=rings.ring_constants())
        return round_scene(path, degree, theta, kind), in_space(exact)
    path = make_mesh(shells, folder / f"{name}_{size}.msh", (LARGE, MIDDLE, SMALL), h=size, order=2)
    return round_scene(path, degree, theta, kind), shell_exact


def joined(path, dim, n):
    """Two blocks like those of `meshes.two_blocks` that share their nodes where they meet."""
    with gmsh_model("joined"):
        occ = gmsh.model.occ
        if dim == 2:
            parts = [(2, occ.addRectangle(0.0, y, 0.0, 1.0, 1.0)) for y in (0.0, 1.0)]
        else:
            parts = [(3, occ.addBox(0.0, 0.0, z, 1.0, 1.0, 1.0)) for z in (0.0, 1.0)]
        occ.fragment(parts[:1], parts[1:])
        occ.synchronize()
        for name, end in (("lower", 0.0), ("upper", 2.0)):
            middle = 0.5 * (1.0 + end)
            near = [tag for _, tag in gmsh.model.getEntities(dim)
                    if abs(occ.getCenterOfMass(dim, tag)[dim - 1] - middle) < 0.1]  # fmt: skip
            group(dim, name, near)
            group(dim - 1, f"{name}_{'bottom' if end == 0.0 else 'top'}",
                  [tag for _, tag in gmsh.model.getEntities(dim - 1)
                   if abs(occ.getCenterOfMass(dim - 1, tag)[dim - 1] - end) < 0.1])  # fmt: skip
        gmsh.option.setNumber("Mesh.MeshSizeMax", 1.0 / n)
        unstructured("triangle" if dim == 2 else "tetrahedron")
        return finish(path, dim, 1)


def loaded(place, kind, n, degree, folder):
    """A block of triangles or tetrahedra under one kind of load."""
    dim = 2 if place == "plane" else 3
    path = make_mesh(one_block, folder / f"block_{dim}_{n}.msh", dim, n, "triangle" if dim == 2 else "tetrahedron")
    rest, ones = [0.0] * (dim - 2), ["free"] * (dim - 1)
    material = Material(10.0, 0.3, density=2.0, expansion=1e-2)
    if kind == "heat_fibres":
        material = Material(*FIBRES[:2], G=FIBRES[2], angle=30.0, expansion=[1e-3, 1e-2, 1e-2])
    held, more = [Displacement("left", [0.0] * dim)], {}
    if kind == "weight":
        more["loads"] = [Load("block", acceleration=[0.0, -0.1, *rest])]
    elif kind == "spin":
        axis = {} if dim == 2 else {"axis": [0.0, 0.0, 1.0]}
        more["loads"] = [Load("block", angular_speed=0.3, point=[0.0, -0.5, *rest], **axis)]
    elif kind == "total":
        moment = 0.1 if dim == 2 else (0.0, 0.0, 0.1)
        more["loads"] = [Load("right", force=[0.1, -0.1, *rest], moment=moment)]
    elif kind.startswith("heat"):
        more["temperatures"] = [Temperature("exp(-8*((x-0.6)**2+(y-0.7)**2))")]
    elif kind == "springs":
        more["springs"] = [Spring("bottom", per_area=100.0), Spring("right", stiffness=[1.0, 3.0, 2.0][:dim]),
                           Spring("block", stiffness=[5.0, 1.0, 2.0][:dim])]  # fmt: skip
        more["loads"], held = [Load("top", traction=[0.3, *rest, -0.5])], []
    else:
        turn = 0.02 if dim == 2 else (0.0, 0.02, 0.02)
        more["couplings"] = [Coupling("right", point=[1.0, 0.5, 0.5][:dim], rotation=turn, average=kind == "average",
                                      displacement=[0.01, *ones[:-1], "free"])]  # fmt: skip
        more["loads"] = [Load("block", body_force=[0.1, -0.1, *rest])]
    return Scene(
        title=f"block, {kind}, degree {degree}", mesh=MeshSpec(path, order=degree), materials={"m": material},
        bodies=[Body("block", "m")], displacements=held, output=Output(fields=False), petsc=DIRECT, **more,
    )  # fmt: skip


def laminates():
    """Materials and bodies of two blocks of laminates, fields of a scene."""
    materials = {name: Material(*FIBRES[:2], G=FIBRES[2], angle=angle)
                 for name, angle in (("lower", 30.0), ("upper", -50.0))}  # fmt: skip
    return {"materials": materials, "bodies": [Body(name, name) for name in materials]}


def blocks(place, kind, n, degree, theta, folder, finer=False):
    """Two blocks of triangles or tetrahedra whose meshes do not match."""
    dim = 2 if place == "plane" else 3
    cell = "triangle" if dim == 2 else "tetrahedron"
    path = make_mesh(two_blocks, folder / f"blocks_{dim}_{n}.msh", dim, n, n + (n + 1) // 2, cell)
    shared = kind in ("joined", "die")
    if shared:
        path = make_mesh(joined, folder / f"joined_{dim}_{n}.msh", dim, n)
    own = 1 if (shared or kind == "lower") and not finer else None
    contact = Contact("upper_bottom", "lower_top", name="face", theta=theta, **BLOCKS[kind])
    lower = Body("lower", "stiff" if kind in ("stiff", "die") else "soft", order=own)
    bodies = {"materials": {"soft": Material(10.0, 0.3), "stiff": Material(10000.0, 0.3)},
              "bodies": [lower, Body("upper", "soft")]}  # fmt: skip
    return Scene(
        title=f"blocks, {kind}, degree {degree}",
        mesh=MeshSpec(path, order=degree),
        **(laminates() if kind == "laminate" else bodies),
        contacts=[] if shared else [contact],
        displacements=[
            Displacement("lower_bottom", [0.0] * dim),
            Displacement("upper_top", [0.02] + [0.0] * (dim - 2) + [-0.05]),
        ],
        output=Output(fields=False),
        petsc=DIRECT,
    )


def _hertz(rest, size, degree, theta, folder):
    case = hertz.CASES[rest]
    if case.dim == 2:
        case = case.scaled(0.5)
    arguments = Namespace(case=rest, order=degree, theta=theta, gamma0=None, drive="displacement", steps=1, hold=2,
                          fields=False)  # fmt: skip
    path = hertz.generate(case, folder / f"{rest}_{size}.msh", size, 1)
    return hertz.make_scene(case, path, arguments), None


def with_middles(scene):
    """The mesh of a scene, with nodes of degree 2 whatever the degree of the displacement. *Collective.*"""
    wide = scene.copy()
    wide.mesh.order = 2
    return build.read(wide, MPI.COMM_WORLD, Options())


def against_finer(simulation, scene):
    """Energy norm of the difference to the solution of degree 2 on the mesh with all cells halved. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        On a mesh of :func:`with_middles`.
    scene : pcontact.scene.model.Scene
        Of degree 2.
    """
    coarse, field = simulation.mesh, at_nodes(simulation.problem.space, simulation.stepper.u)
    n = sum(len(block.nodes) for block in coarse.blocks)
    mesh, (field,) = refine(coarse, np.full(n, coarse.dim), (field,), Balance(*build.balance(scene, Options())))
    with running(scene, mesh=mesh) as (fine, converged):
        if not converged:
            return float("nan")
        space = fine.problem.space
        difference = fine.stepper.u.copy()
        difference.getArray().reshape(-1, space.dim)[:] -= field[space.mesh_nodes[space.owned_local]]
        difference.assemble()
        forces = np.zeros((space.n_owned, space.dim))
        ElasticBulk.residual(fine.problem.items[0], difference, forces)
        own_work = float(np.vdot(forces, difference.getArray(readonly=True)))
        return float(np.sqrt(fine.comm.allreduce(own_work, op=MPI.SUM)))


def measure(name, size, degree, theta, folder):
    """One mesh: a dict. *Collective.*"""
    scene, exact = prepare(name, size, degree, theta, folder)
    scene.output.estimate = True
    with running(scene, mesh=None if exact is not None else with_middles(scene)) as (simulation, converged):
        if not converged:
            raise InputError(f"{name}: a load step did not converge; allowed: other sizes")
        row = {"size": size, "cells": simulation.mesh.n_cells_total, "unknowns": simulation.problem.space.n_dofs,
               **simulation.error_estimate.last}  # fmt: skip
        if exact is not None:
            bulk = simulation.problem.bulk
            error = bulk_error(simulation.problem.space, bulk.constants, simulation.stepper.u, exact, averaged=True,
                               orthotropic=bulk.orthotropic)  # fmt: skip
            row["error"] = error.energy
        else:
            row["error"] = against_finer(simulation, prepare(name, size, 2, theta, folder, True)[0])
    row["effectivity"] = row["absolute"] / row["error"]
    return row


def _paint(axes, results):
    for number, one in enumerate(results):
        rows = one["meshes"]
        style = {1: "o-", 2: "s--"}[one["degree"]]
        axes[0].loglog([r["unknowns"] for r in rows], [r["error"] / r["energy_norm"] for r in rows], style, mfc="none",
                       color=f"C{number % 10}")  # fmt: skip
        axes[0].loglog([r["unknowns"] for r in rows], [r["relative"] for r in rows], ":", color=f"C{number % 10}")
        label = f"{one['case']}, {one['degree']}, {one['theta']:g}"
        axes[1].semilogx([r["unknowns"] for r in rows], [r["effectivity"] for r in rows], style, mfc="none",
                         color=f"C{number % 10}", label=label)  # fmt: skip
    axes[0].set(xlabel="unknowns", ylabel="relative error; dotted: estimate")
    axes[1].axhspan(0.5, 3.0, color="0.93")
    axes[1].set(xlabel="unknowns", ylabel="effectivity", ylim=(0, 3.2))
    axes[1].legend(fontsize=4, ncols=2)


def run(args):
    """All cases; exit status."""
    results = []
    for name in TINY if args.tiny else args.case:
        sizes = SIZES[name][: 1 if args.tiny else args.meshes]
        thetas = [0.0] if args.tiny or name.startswith(ONCE) else args.theta
        for degree in [d for d in args.degree if d == 2 or name not in DEGREE_2]:
            for theta in thetas:
                rows = [measure(name, size, degree, theta, args.o) for size in sizes]
                widths = [size if size < 1 else 1.0 / size for size in sizes]
                for key in ("error", "absolute"):
                    for row, rate in zip(rows, observed_rates(widths, [r[key] for r in rows]), strict=True):
                        row[f"{key}_rate"] = rate
                results.append({"case": name, "degree": degree, "theta": theta, "meshes": rows})
                _table(results[-1])
    every = [row["effectivity"] for one in results for row in one["meshes"]]
    log.info("effectivity: %.3f to %.3f", min(every), max(every))
    write_json(args.o / "effectivity.json", {"effectivity": [min(every), max(every)], "results": results})
    draw(args.o / "effectivity.png", partial(_paint, results=results), columns=2)
    return 0


def _table(one):
    parts = ("interior", "jumps", "neumann", "contact", "friction")
    header = ["size", "cells", "unknowns", "error", "rate", "estimate", "rate", "effectivity", *parts, "algebraic"]
    rows = [
        [row[k] for k in ("size", "cells", "unknowns")]
        + [row["error"] / row["energy_norm"], row["error_rate"], row["relative"], row["absolute_rate"]]
        + [row["effectivity"], *(row["parts"][k] / row["absolute"] for k in parts), row["algebraic"] / row["absolute"]]
        for row in one["meshes"]
    ]
    print_table(f"{one['case']}, degree {one['degree']}, theta {one['theta']:g}", header, rows)


def parser():
    """The driver's options."""
    p = make_parser(__doc__, "effectivity_results")
    add = p.add_argument
    add("--case", nargs="+", default=list(SIZES), choices=list(SIZES), help="all, if nothing is said")
    add("--degree", type=int, nargs="+", default=[1, 2], choices=[1, 2], help="of the displacement")
    add("--theta", type=float, nargs="+", default=[1.0, 0.0, -1.0], choices=[1.0, 0.0, -1.0])
    add("--meshes", type=int, default=3, choices=[1, 2, 3], help="of each case")
    return p


if __name__ == "__main__":
    main(run, parser())
