"""What curved facets of a first mesh leave of the error on any finer one, and what is named of it.

Rings and spherical shells in contact whose solutions are known (Lame), with a displacement of degree 2. Nodes of finer
meshes lie on the facets of the first one. `left` is the error on the mesh whose cells have been halved as often as it
says, without what these cells leave of the error that the first mesh has with smooth surfaces (a quarter, halving by
halving). `named` is the root of the sum of the squares of `change`, that of the solution on the first mesh with smooth
surfaces, and of `rough` (`pcontact.adapt.roughness`).

    python drivers/studies/facets.py -o facets
"""

from functools import partial

import numpy as np

from drivers._common import main, make_mesh, make_parser, print_table, write_json
from drivers.cases import rings
from drivers.studies._round_bodies import LARGE, MIDDLE, SMALL, round_scene, shell_exact
from meshes import rings as ring_mesh
from meshes.shells import shells
from pcontact import build
from pcontact.adapt import roughness, variants
from pcontact.adapt.watch import Watch
from pcontact.assembly.error_norms import bulk_error
from pcontact.mesh.refinement.refine import Balance, refine
from pcontact.runtime.errors import StepFailure
from pcontact.runtime.options import Options
from pcontact.simulation import Simulation

# interference, pressure, facets in a quarter, halvings
RINGS = [(delta, pressure, n, 3) for delta, pressure in ((0.0, 1e7), (6e-4, 0.0)) for n in (4, 6, 12)]
# size of cells, halvings
SHELLS = [(0.25, 1), (0.2, 1), (0.15, 1)]


def cases(args):
    """Title, scene, exact solution and halvings of each."""
    for delta, pressure, n, halvings in RINGS[:1] if args.tiny else RINGS:
        path = make_mesh(ring_mesh, args.o / f"rings_{delta:g}_{n}.msh", n=n, cell="triangle", order=2, delta=delta)
        exact = partial(rings.exact, constants=rings.ring_constants(pressure, delta))
        title = f"rings, interference {delta:g}, {n} facets in a quarter"
        yield title, rings.ring_scene(path, 2, 0.0, pressure=pressure, gamma0=None), exact, 1 if args.tiny else halvings
    for h, halvings in () if args.tiny else SHELLS:
        path = make_mesh(shells, args.o / f"shells_{h:g}.msh", (LARGE, MIDDLE, SMALL), h=h, order=2)
        yield f"shells, cells of {h:g}", round_scene(path, 2, 0.0, "shells"), shell_exact, halvings


def error_of(problem, u, exact):
    """Energy norm of the error, and of the solution. *Collective.*"""
    found = bulk_error(problem.space, problem.bulk.constants, u, exact)
    return found.energy, found.energy_of_exact


def left_of(first, scene, exact, halvings):
    """Energy norm of the error on the mesh that is halved. *Collective.*"""
    mesh = first.mesh
    for _ in range(halvings):
        n = sum(len(block.nodes) for block in mesh.blocks)
        mesh = refine(mesh, np.full(n, mesh.dim), (), Balance(*build.balance(scene, Options()))).mesh
    finer = Simulation(scene, mesh=mesh)
    try:
        if not finer.run(None, [], keep=True):
            raise StepFailure(str(finer.failure))
        return error_of(finer.problem, finer.stepper.u, exact)[0]
    finally:
        finer.free()


def measure(title, scene, exact, halvings):
    """A row: a dict. *Collective.*"""
    scene.output.estimate = True
    first = Simulation(scene)
    watch = Watch(first)
    if not first.run(None, [watch], keep=True):
        raise StepFailure(str(first.failure))
    first.close()
    own, size = error_of(first.problem, first.stepper.u, exact)
    smooth = variants.smooth_facets(scene)
    with variants.solved(smooth, first.comm, first.options.said, first.mesh) as (run, _):
        change = first.stepper.u.copy()
        change.axpy(-1.0, run.stepper.u)
        change = first.error_estimate.norm(change)
        rough = roughness.energy(first, watch)
        mesh = error_of(run.problem, run.stepper.u, exact)[0]
    left = left_of(first, scene, exact, halvings)
    first.free()
    left = np.sqrt(max(left**2 - (mesh / 4.0**halvings) ** 2, 0.0))
    named = float(np.hypot(change, rough))
    return {"case": title, "error": own / size, "left": left / size, "halvings": halvings, "change": change / size,
            "rough": rough / size, "named": named / size, "over": named / left}  # fmt: skip


def run(args):
    """All rows; exit status."""
    rows = [measure(*one) for one in cases(args)]
    head = ["case", "error", "left", "halvings", "change", "rough", "named", "named / left"]
    print_table("curved facets", head, [list(row.values()) for row in rows])
    write_json(args.o / "facets.json", rows)
    return 0


if __name__ == "__main__":
    main(run, make_parser(__doc__, "facets_results"))
