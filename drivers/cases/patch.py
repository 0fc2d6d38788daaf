"""The patch test (El-Abbasi and Bathe; code_aster SSNP121): does uniform pressure pass through the contact?

Two blocks of total height 2, E = 2e6, nu = 0, plane strain, bottom fixed, top pushed down by 0.1. The
pressure is 1e5 everywhere and u = -0.05 y. First table: meshes that match, are nested or neither, for every
cell, degree, theta and search: source facets are cut where their partner changes, the quadrature is exact and
so is the answer. Second table: meshes in space that do not match and whole source facets (``cut = false``),
where the error is that of the quadrature across the edges of the target. It falls with its degree, not evenly,
since the points may lie well or badly about the edges.
"""

from itertools import product

import numpy as np

from drivers._common import draw, main, make_mesh, make_parser, print_table, running, write_json
from meshes import two_blocks
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene

E_MODULUS, PUSH, PRESSURE, SLOPE = 2e6, 0.1, 1e5, -0.05
CELLS = {2: ("triangle", "quadrilateral"), 3: ("tetrahedron", "hexahedron")}
# facets along the interface, below and above
EXACT = ((3, 3), (2, 4), (3, 4), (4, 3))
THETAS = (0.0, 1.0, -1.0)
SEARCHES = ("closest_point", "ray_tracing")
DEGREES = (1, 3, 5, 7, 9, 13, 17, 20)


def scene(path, dim, order=1, length=1.0, stress=1.0, petsc=None, **contact):
    """The scene on a mesh of :func:`meshes.two_blocks`.

    Parameters
    ----------
    path : mesh file
    dim : int
    order : degree of the displacement
    length, stress : float
        Units: the mesh's lengths and the moduli are multiplied by them.
    petsc : dict of str to str, optional
    contact : further keys of :class:`pcontact.scene.model.Contact`
    """
    free = ["free"] * (dim - 1)
    supports = [
        Displacement("lower_bottom", [*free, 0.0]),
        Displacement("upper_top", [*free, -PUSH * length]),
        Displacement("left", [0.0, *free]),
    ]
    if dim == 3:
        supports.append(Displacement("front", ["free", 0.0, "free"]))
    return Scene(
        title="Patch test",
        mesh=MeshSpec(path, order=order),
        materials={"elastic": Material(E=E_MODULUS * stress, nu=0.0)},
        bodies=[Body("lower", "elastic"), Body("upper", "elastic")],
        contacts=[Contact(**{"source": "upper_bottom", "target": "lower_top", "name": "patch", **contact})],
        displacements=supports,
        output=Output(fields=False, probes=["lower_top", "upper_bottom"]),
        petsc={"snes_rtol": "1e-13", **(petsc or {})},
    )


def errors(simulation, length=1.0, stress=1.0):
    """Largest relative errors of the displacement and of the contact pressure. *Collective.*"""
    space, u, comm = simulation.problem.space, simulation.stepper.u, simulation.comm
    exact = np.zeros(space.points.shape)
    exact[:, -1] = SLOPE * space.points[:, -1]
    pressure = simulation.problem.contacts[0].state(u)["pressure"]
    wrong = [
        np.max(np.abs(space.local.gather(u) - exact), initial=0.0) / (0.5 * PUSH * length),
        np.max(np.abs(pressure / (PRESSURE * stress) - 1.0), initial=0.0),
    ]
    return [float(comm.allreduce(value, op=MPI.MAX)) for value in wrong]


def exact_cases(directory, dims, orders=(1, 2), meshes=EXACT):
    """One row for each pair of meshes, degree, theta and search. *Collective.*"""
    rows = []
    for dim, mixed in product(dims, (False, True)):
        for cell, (n_lower, n_upper) in product(CELLS[dim], meshes):
            other = CELLS[dim][1 - CELLS[dim].index(cell)] if mixed else None
            path = directory / "patch.msh"
            make_mesh(two_blocks, path, dim, n_lower, n_upper, cell, cell_upper=other)
            for order, theta, search in product(orders, THETAS, SEARCHES):
                with running(scene(path, dim, order, theta=theta, search=search, cut=True)) as (simulation, converged):
                    u, p = errors(simulation)
                    row = (other or cell, cell, f"{n_upper} on {n_lower}", order, theta, search)
                    rows.append([*row, converged, u, p])
    return rows


def quadrature_cases(directory, degrees=DEGREES):
    """Rows of non-matching meshes, source finer and target finer: one error for each degree. *Collective.*"""
    rows = []
    for cell, (n_lower, n_upper) in product(CELLS[3], ((3, 4), (4, 3))):
        path = make_mesh(two_blocks, directory / "patch.msh", 3, n_lower, n_upper, cell)
        row = []
        for degree in degrees:
            with running(scene(path, 3, quadrature=degree, cut=False)) as (simulation, _):
                row.append(errors(simulation)[1])
        rows.append([cell, "source" if n_upper > n_lower else "target", *row])
    return rows


def _plot(rows, degrees):
    def paint(axes):
        for row in rows:
            axes.semilogy(degrees, row[2:], "o-", label=f"{row[0]}, {row[1]} finer")
        axes.set_xlabel("degree of the quadrature")
        axes.set_ylabel("largest relative error of the pressure")
        axes.legend(fontsize="small")

    return paint


def run(args):
    """Both tables; 1 when a mesh on which the quadrature is exact does not give the exact answer."""
    dims = [2] if args.tiny else args.dim
    degrees = DEGREES[::4] if args.tiny else DEGREES
    # in a tiny run: nested meshes, and meshes that do not match
    few = {"orders": (1,), "meshes": EXACT[1:3]} if args.tiny else {}
    exact = exact_cases(args.o, dims, **few)
    keys = ["above", "below", "facets", "degree", "theta", "search", "converged", "error u", "error p"]
    print_table("exact quadrature", keys, exact)
    rough = quadrature_cases(args.o, degrees) if args.tiny or 3 in dims else []
    if rough:
        header = ["cell", "finer", *map(str, degrees)]
        print_table("largest relative error of the pressure by degree of the quadrature", header, rough)
        draw(args.o / "patch.png", _plot(rough, degrees))
    data = {"columns": keys, "exact": exact, "degrees": degrees, "quadrature": rough}
    write_json(args.o / "patch.json", data)
    return 0 if all(row[-3] and max(row[-2:]) < 1e-9 for row in exact) else 1


if __name__ == "__main__":
    parser = make_parser(__doc__, "patch_results")
    parser.add_argument("--dim", type=int, nargs="+", default=[2, 3], choices=[2, 3], help="dimensions")
    main(run, parser)
