"""What simplices cost that quadrilaterals and hexahedra are divided into, beside these cells themselves.

The round cases of `effectivity.py` with exact solutions are solved on meshes of quadrilaterals or hexahedra, and on the
same meshes divided into triangles or tetrahedra (`pcontact.mesh.refinement.split`): the same nodes. The columns are the
errors in the energy norm, their ratio, that of the errors that the loop would name (estimate over the least effectivity
of the class), and that of the entries of the tangent. `pcontact/adapt/cells.py` has one ratio of names and one of
entries for each dimension and degree (`MEASURED`), by which a run with ``-error`` decides.

``--reach`` runs scenes of quadrilaterals and hexahedra with ``-error`` instead, and says what was chosen.
"""

import json
from dataclasses import replace
from functools import partial

import numpy as np

from drivers._common import main, make_mesh, make_parser, print_table, running, write_json
from drivers.cases import rings
from drivers.error_norms import bulk_error
from drivers.studies._harness import composed
from drivers.studies.adapt import punch_scene
from drivers.studies.effectivity import prepare
from meshes import rings as ring_mesh
from meshes import two_blocks
from meshes.punch import punch
from pcontact import build
from pcontact.adapt.effectivity import UNSEEN
from pcontact.adapt.loop import Loop
from pcontact.material.elastic import in_plane, lame
from pcontact.mesh.refinement.split import split
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.model import Contact, Material, MeshSpec, Output
from pcontact.scene.target import Target

# numbers of cells, by the names of effectivity.py; those of --tiny first
SIZES = {
    "rings-quadrilateral": (4, 8, 16),
    "cylinder-axisymmetric-quadrilateral": (4, 8, 16),
    "tubes-hexahedron": (4, 8),
    "cylinder-space-hexahedron": (2, 4, 8),
}
HEAD = ("case", "degree", "cells", "unknowns", "error", "of simplices", "ratio", "ratio named", "ratio entries")


def solved(scene, mesh, exact):
    """Relative error, that which would be named, entries of the tangent, and unknowns. *Collective.*"""
    with running(scene, mesh=mesh) as (simulation, _):
        space = simulation.problem.space
        materials = [simulation.scene.materials[body.material] for body in simulation.scene.bodies]
        constants = [in_plane(*lame(one.E, one.nu), simulation.scene.mesh.kinematics) for one in materials]
        error = bulk_error(space, constants, simulation.stepper.u, exact)
        found = simulation.error_estimate.last
        least = UNSEEN[mesh.dim, space.degree][0]
        entries = simulation.problem.matrix.matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
        named = found["absolute"] / found["energy_norm"] / least
        return error.energy / error.energy_of_exact, named, entries, space.n_dofs


def _punch(folder):
    path = make_mesh(punch, folder / "punch.msh", h=0.5, order=2, cell="quadrilateral")
    return replace(punch_scene(path, 2, 0.0), output=Output(fields=False), petsc={})


def _rings(folder):
    scene = rings.ring_scene(make_mesh(ring_mesh, folder / "rings.msh", n=4, order=2), 1, 0.0, gamma0=None)
    return replace(scene, mesh=replace(scene.mesh, order=None))


def _blocks(degree, folder):
    path = make_mesh(two_blocks, folder / "blocks.msh", 3, 3, 2, "hexahedron")
    return composed(
        MeshSpec(path, order=degree),
        dict.fromkeys(("lower", "upper"), Material(10.0, 0.3)),
        {"lower_bottom": [0.0] * 3, "upper_top": [0.0, 0.0, -0.05]},
        contacts=[Contact("upper_bottom", "lower_top", name="face")],
    )


# scenes and targets of --reach
REACHED = {
    "punch, quadrilaterals of degree 2": (_punch, (0.05, 0.02)),
    "rings, quadrilaterals": (_rings, (0.01,)),
    "blocks, hexahedra of degree 1": (partial(_blocks, 1), (0.1, 0.05)),
    "blocks, hexahedra of degree 2": (partial(_blocks, 2), (0.05,)),
}


def reach(args):
    """A table of what named errors take; exit status."""
    rows = []
    for name, (make, targets) in REACHED.items():
        for target in targets:
            loop = Loop(replace(make(args.o), accuracy=Target(target)))
            loop.run(args.o / "run")
            last = loop.passes[-1]
            chosen = json.loads((args.o / "run" / "report.json").read_text())["accuracy"].get("cells", {})
            rows.append([name, target, chosen.get("chosen", ""), len(loop.passes), last.unknowns, last.entries,
                         last.error])  # fmt: skip
            print_table("", ("scene", "target", "chosen", "passes", "unknowns", "entries", "named"), rows)
    return 0


def run(args):
    """A table of all cases; exit status."""
    if args.reach:
        return reach(args)
    rows = []
    for name in list(SIZES)[:1] if args.tiny else SIZES:
        for degree in (1, 2):
            for size in SIZES[name][:1] if args.tiny else SIZES[name]:
                scene, exact = prepare(name, size, degree, 0.0, args.o)
                scene.output.estimate = True
                mesh = build.read(scene, MPI.COMM_WORLD, Options())
                own, other = solved(scene, mesh, exact), solved(scene, split(mesh).mesh, exact)
                ratios = [float(np.divide(b, a)) for a, b in zip(own[:3], other[:3], strict=True)]
                rows.append([name, degree, size, other[3], own[0], other[0], *ratios])
    print_table("simplices over the cells they were made of", HEAD, rows)
    write_json(args.o / "cells.json", [dict(zip(HEAD, row, strict=True)) for row in rows])
    return 0


def parser():
    """The driver's options."""
    p = make_parser(__doc__, "cells_results")
    p.add_argument("--reach", action="store_true", help="runs with -error")
    return p


if __name__ == "__main__":
    main(run, parser())
