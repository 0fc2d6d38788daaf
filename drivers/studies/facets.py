"""What curved facets of a first mesh leave of the error on any finer one, and what is named of it.

Rings and spherical shells in contact whose solutions are known (Lame), with a displacement of degree 2. Nodes of finer
meshes lie on the facets of the first one. `left` is the error on the mesh whose cells have been halved as often as it
says, in the plane those on the contact twice more, without what these cells leave of the error that the first mesh
has with smooth surfaces (a quarter, halving by halving). `change` is that of the solution, or of its pressure in L2, on
the first mesh with smooth surfaces; `named` is as many times that as `pcontact.adapt.secondary.FINER_SEE` says.

    python drivers/studies/facets.py -o facets
"""

from functools import partial

import numpy as np

from drivers._common import main, make_mesh, make_parser, print_table, write_json
from drivers.cases import rings
from drivers.error_norms import bulk_error
from drivers.studies._round_bodies import LARGE, MIDDLE, SMALL, round_scene, shell_exact, shell_pressure
from meshes import rings as ring_mesh
from meshes.shells import shells
from pcontact import build
from pcontact.adapt import secondary
from pcontact.adapt.secondary import FINER_SEE, solved
from pcontact.estimate import goal
from pcontact.mesh.refinement.refine import Balance, refine
from pcontact.runtime.errors import StepFailure
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI
from pcontact.simulation import Simulation

# interference, pressure, facets in a quarter, halvings
RINGS = [(delta, pressure, n, 3) for delta, pressure in ((0.0, 1e7), (6e-4, 0.0)) for n in (4, 6, 12)]
# size of cells, halvings
SHELLS = [(0.25, 1), (0.2, 1), (0.15, 1)]
# Halvings more of the cells on the contact, by the dimension: a pressure meets kinks of the gaps late.
NEAR = {2: 2, 3: 0}


def cases(args):
    """Title, scene, exact displacement and pressure, and halvings of each."""
    for delta, pressure, n, halvings in RINGS[:1] if args.tiny else RINGS:
        path = make_mesh(ring_mesh, args.o / f"rings_{delta:g}_{n}.msh", n=n, cell="triangle", order=2, delta=delta)
        exact = partial(rings.exact, constants=rings.ring_constants(pressure, delta))
        title = f"rings, interference {delta:g}, {n} facets in a quarter"
        scene = rings.ring_scene(path, 2, 0.0, pressure=pressure, gamma0=None)
        yield title, scene, exact, rings.interface_pressure(pressure, delta), 1 if args.tiny else halvings
    for h, halvings in () if args.tiny else SHELLS:
        path = make_mesh(shells, args.o / f"shells_{h:g}.msh", (LARGE, MIDDLE, SMALL), h=h, order=2)
        yield f"shells, cells of {h:g}", round_scene(path, 2, 0.0, "shells"), shell_exact, shell_pressure(), halvings


def errors_of(problem, u, exact, pressure):
    """Errors of the energy norm and of the pressure in L2, and the norms themselves (2, 2). *Collective.*"""
    found, state = bulk_error(problem.space, problem.bulk.constants, u, exact), problem.contacts[0].state(u)
    own = [state["weight"] @ (state["pressure"] - pressure) ** 2, pressure**2 * state["weight"].sum()]
    squares = np.sqrt(problem.space.comm.allreduce(np.array(own), op=MPI.SUM))
    return np.array([[found.energy, squares[0]], [found.energy_of_exact, squares[1]]])


def left_of(first, scene, exact, pressure, halvings):
    """Both errors on the mesh that is halved. *Collective.*"""
    mesh, contact = first.mesh, scene.contacts[0]
    for number in range(halvings + NEAR[mesh.dim]):
        first_cell = np.cumsum([0] + [len(block.nodes) for block in mesh.blocks])
        more = np.full(first_cell[-1], mesh.dim if number < halvings else 0)
        for some in (part for name in (contact.source, contact.target) for part in mesh.facet_groups.get(name, [])):
            more[first_cell[some.block] + some.cells] = mesh.dim
        mesh = refine(mesh, more, (), Balance(*build.balance(scene, Options()))).mesh
    finer = Simulation(scene, mesh=mesh)
    try:
        if not finer.run(None, [], keep=True):
            raise StepFailure(str(finer.failure))
        return errors_of(finer.problem, finer.stepper.u, exact, pressure)[0]
    finally:
        finer.free()


def change_of_pressure(first, run, name):
    """Distance of the pressures of two runs on one mesh in L2. *Collective.*"""
    own = (goal.named(one.problem, name, one.stepper.u) for one in (first, run))
    return goal.apart(first.comm, *own)


def measure(title, scene, exact, pressure, halvings):
    """Two rows (dicts), of the energy norm and of the pressure. *Collective.*"""
    scene.output.estimate = True
    first = Simulation(scene)
    if not first.run(None, [], keep=True):
        raise StepFailure(str(first.failure))
    first.close()
    name = first.scene.contacts[0].name
    own, size = errors_of(first.problem, first.stepper.u, exact, pressure)
    smooth = secondary.smooth_facets(scene)
    with solved(smooth, first.comm, first.options.said, first.mesh) as (run, _):
        change = first.stepper.u.copy()
        change.axpy(-1.0, run.stepper.u)
        change = np.array([first.error_estimate.norm(change), change_of_pressure(first, run, name)])
        mesh = errors_of(run.problem, run.stepper.u, exact, pressure)[0]
    left = left_of(first, scene, exact, pressure, halvings)
    first.free()
    left = np.sqrt(np.maximum(left**2 - (mesh / 4.0**halvings) ** 2, 0.0))
    named = FINER_SEE["curved_facets"] * change
    return [{"case": title, "of": of, "error": own[k] / size[k], "left": left[k] / size[k], "halvings": halvings,
             "change": change[k] / size[k], "named": named[k] / size[k],
             "over": named[k] / left[k]} for k, of in enumerate(("energy", "pressure"))]  # fmt: skip


def run(args):
    """All rows; exit status."""
    rows = [row for one in cases(args) for row in measure(*one)]
    head = ["case", "of", "error", "left", "halvings", "change", "named", "named / left"]
    print_table("curved facets", head, [list(row.values()) for row in rows])
    write_json(args.o / "facets.json", rows)
    return 0


if __name__ == "__main__":
    main(run, make_parser(__doc__, "facets_results"))
