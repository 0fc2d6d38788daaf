"""What simplices cost that quadrilaterals and hexahedra are divided into, beside these cells themselves.

The round cases of `effectivity.py` with exact solutions are solved on meshes of quadrilaterals or hexahedra, and on the
same meshes divided into triangles or tetrahedra (`pcontact.mesh.refinement.split`): the same nodes. The columns are the
errors in the energy norm, their ratio, that of the errors that the loop would name (estimate over the least effectivity
of the class), and that of the entries of the tangent. `pcontact/adapt/cells.py` has one ratio of names and one of
entries for each dimension and degree (`MEASURED`), by which a run with ``-error`` decides.
"""

import numpy as np

from drivers._common import main, make_parser, print_table, running, write_json
from drivers.studies.effectivity import prepare
from pcontact import build
from pcontact.adapt.known import effectivity
from pcontact.assembly.error_norms import bulk_error
from pcontact.material.elastic import in_plane, lame
from pcontact.mesh.refinement.split import split
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI, PETSc

# numbers of cells, by the names of effectivity.py; those of --tiny first
SIZES = {
    "rings-quadrilateral": (4, 8, 16),
    "cylinder-axisymmetric-quadrilateral": (4, 8, 16),
    "tubes-hexahedron": (4, 8),
    "cylinder-space-hexahedron": (2, 4, 8),
}
HEAD = ("case", "degree", "cells", "unknowns", "error", "of simplices", "ratio", "ratio named", "ratio entries")


def solved(scene, mesh, exact, simplices):
    """Relative error, that which would be named, entries of the tangent, and unknowns. *Collective.*"""
    with running(scene, mesh=mesh) as (simulation, _):
        space = simulation.problem.space
        materials = [simulation.scene.materials[body.material] for body in simulation.scene.bodies]
        constants = [in_plane(*lame(one.E, one.nu), simulation.scene.mesh.kinematics) for one in materials]
        error = bulk_error(space, constants, simulation.stepper.u, exact)
        found = simulation.error_estimate.last
        least = effectivity(simulation.scene, simplices, mesh.dim, space.degree).least
        entries = simulation.problem.matrix.matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
        named = found["absolute"] / found["energy_norm"] / least
        return error.energy / error.energy_of_exact, named, entries, space.n_dofs


def run(args):
    """A table of all cases; exit status."""
    rows = []
    for name in list(SIZES)[:1] if args.tiny else SIZES:
        for degree in (1, 2):
            for size in SIZES[name][:1] if args.tiny else SIZES[name]:
                scene, exact = prepare(name, size, degree, 0.0, args.o)
                scene.output.estimate = True
                mesh = build.read(scene, MPI.COMM_WORLD, Options())
                own, other = solved(scene, mesh, exact, False), solved(scene, split(mesh).mesh, exact, True)
                ratios = [float(np.divide(b, a)) for a, b in zip(own[:3], other[:3], strict=True)]
                rows.append([name, degree, size, other[3], own[0], other[0], *ratios])
    print_table("simplices over the cells they were made of", HEAD, rows)
    write_json(args.o / "cells.json", [dict(zip(HEAD, row, strict=True)) for row in rows])
    return 0


if __name__ == "__main__":
    main(run, make_parser(__doc__, "cells_results"))
