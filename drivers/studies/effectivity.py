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
                (joined; die: 1000 times as stiff); the error as for Hertz, but that in the plane cells with large
                estimates, those at the corners, are halved three times more
    wound       two orthotropic rings in contact, plane strain, a laminate that is wound around one of wood
                (Lekhnitskii 1963); a thick cylinder of the laminate in space, with axial symmetry
    loads       a block that is held on its left side, under its weight, the force of a turn about an axis, a total
                force and moment, a temperature with a hot spot; on stiff springs; moved by a group that is rigid, or
                moves so on average; the error as for the blocks

A case, a degree and a theta take one row per mesh. The cells of the round cases are curved (degree 2), but for Hertz.
"""

from argparse import Namespace
from functools import partial

import numpy as np

from drivers._common import draw, log, main, make_mesh, make_parser, observed_rates, print_table, running, write_json
from drivers.cases import hertz, indent, rings, thick_cylinder
from drivers.error_norms import bulk_error
from drivers.studies._block_scenes import BLOCKS, DIRECT, LOADS, blocks, loaded
from drivers.studies._overkill import total
from drivers.studies._round_bodies import (
    LARGE,
    MIDDLE,
    SMALL,
    cylinder_exact,
    in_space,
    round_scene,
    shell_exact,
    wound_cylinder,
    wound_rings,
)
from meshes import indent as indent_mesh
from meshes import rings as ring_mesh
from meshes.shells import shells, tubes
from pcontact import build
from pcontact.adapt.passes import at_nodes
from pcontact.mesh.refinement.refine import Balance, refine
from pcontact.runtime.errors import InputError
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI

# [-] Of the squared estimate: cells that have more are those at singular points. From: smooth solutions have less.
LARGE_SHARE = 0.01
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
            return wound_cylinder(what, cell, size, degree, folder)
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
        return scene, partial(cylinder_exact, form, 100.0, dim)
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


def against_finer(simulation, scene, corners=False):
    """Energy norm of the difference to the solution of degree 2 on the mesh with all cells halved. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        On a mesh of :func:`with_middles`.
    scene : pcontact.scene.model.Scene
        Of degree 2.
    corners : bool
        Whether cells that have more than a part `LARGE_SHARE` of the squared estimate are halved three times more.
    """
    coarse, field = simulation.mesh, at_nodes(simulation.problem.space, simulation.stepper.u)
    more = np.full(sum(len(block.nodes) for block in coarse.blocks), coarse.dim)
    if corners:
        squares = np.concatenate([np.zeros(0), *simulation.error_estimate.cells]) ** 2
        more[squares > LARGE_SHARE * total(simulation.comm, squares.sum())] *= 4
    mesh, (field,) = refine(coarse, more, (field,), Balance(*build.balance(scene, Options())))
    with running(scene, mesh=mesh) as (fine, converged):
        if not converged:
            return float("nan")
        space = fine.problem.space
        difference = fine.stepper.u.copy()
        difference.getArray().reshape(-1, space.dim)[:] -= field[space.mesh_nodes[space.owned_local]]
        difference.assemble()
        forces = np.zeros((space.n_owned, space.dim))
        fine.problem.items[0].elastic_forces(difference, forces)
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
            finer = prepare(name, size, 2, theta, folder, True)[0]
            row["error"] = against_finer(simulation, finer, name.startswith(("blocks-plane", "loads-plane")))
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
