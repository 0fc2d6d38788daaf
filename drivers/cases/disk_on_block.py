"""A disk resting on a block (Chouly, Mlika, Renard): how the error depends on gamma0 and theta.

Disk of radius 0.25 around the origin, block ]-0.5, 0.5[ x ]-0.5, -0.25[, lambda = mu = 1, plane strain,
body force -0.1 in the disk, bottom of the block fixed. Two pins keep the disk from moving sideways and from
turning; vertically it is held by the contact alone. For every theta and gamma0 over six decades the energy
norm of the error is measured against a solution of degree 2 on a finer mesh. Theory: theta = -1 needs no
lower bound of gamma0, theta = 1 and 0 are coercive only above 1 and 1/4 (on every mesh). Below, the error
grows, Newton's method finds nothing, or finds one of several solutions.
"""

from pathlib import Path

import matplotlib.tri as tri
import numpy as np

from drivers._common import draw, log, main, make_mesh, make_parser, print_table, running, write_json
from drivers.error_norms import bulk_error
from meshes import disk_on_block
from pcontact.element.reference import shape, shape_gradient
from pcontact.runtime.petsc import MPI, full_steps, has_package
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene, Steps

CONSTANTS = [(1.0, 1.0), (1.0, 1.0)]  # lambda, mu of both bodies
THETAS = (1.0, 0.0, -1.0)
FORCE = 0.1


def _solver():
    """Full Newton steps, as in the paper, and a direct solver if there is one, so that a failure is Newton's.

    Below the bound of theta = 1 the tangent is not definite, and a Krylov method would give up first.
    """
    options = {"snes_rtol": "1e-9", "snes_linesearch_type": full_steps}
    if MPI.COMM_WORLD.size == 1 or has_package("mumps"):
        options["pc_type"] = "lu"
    return options


def scene(path, theta=-1.0, gamma0=None, order=1, petsc=None):
    """The scene on a mesh of :func:`meshes.disk_on_block`.

    Parameters
    ----------
    path : mesh file
    theta, gamma0 : of the contact
    order : degree of the displacement
    petsc : dict of str to str, optional
        Options that come before the study's own, see :func:`_solver`.
    """
    free = "free"
    return Scene(
        title=f"Disk on block, theta {theta:g}, gamma0 {gamma0}",
        mesh=MeshSpec(path, order=order),
        materials={"unit": Material(E=2.5, nu=0.25)},
        bodies=[Body("disk", "unit"), Body("block", "unit")],
        contacts=[Contact("disk_lower_skin", "block_top", name="disk-block", theta=theta, gamma0=gamma0)],
        displacements=[
            Displacement("block_bottom", [0.0, 0.0]),
            Displacement("pin_0", [0.0, free]),
            Displacement("pin_1", [0.0, free]),
        ],
        loads=[Load("disk", body_force=[0.0, -FORCE])],
        # one step or none: a gamma0 at which Newton's method fails is a result here
        steps=Steps(count=1, min_step=0.6),
        output=Output(fields=False, probes=["pin_0", "disk_tip"]),
        allow_unsafe=["gamma0"],
        petsc={**_solver(), **(petsc or {})},
    )


class Reference:
    """A solution of degree 2 on straight triangles as a function of position, on every rank. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        Finished. Its solution is small and is gathered on all ranks.
    """

    def __init__(self, simulation):
        space, comm = simulation.problem.space, simulation.comm
        nodal = space.local.gather(simulation.stepper.u)
        self._bodies = []
        for body in range(2):
            corners, values = [], []
            for block, cells in zip(space.mesh.blocks, space.cells, strict=True):
                if block.body == body:
                    corners.append(space.points[cells[:, :3]])
                    values.append(nodal[cells])
            corners = np.concatenate([a for part in comm.allgather(corners) for a in part])
            values = np.concatenate([a for part in comm.allgather(values) for a in part])
            points, index = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
            mesh = tri.Triangulation(*points.T, index.reshape(-1, 3))
            self._bodies.append((mesh.get_trifinder(), corners, values))

    def __call__(self, x, body):
        """Displacement (n, 2) and its gradient (n, 2, 2) at points x (n, 2) of a body."""
        finder, corners, values = self._bodies[body]
        cell = finder(*x.T)
        if np.any(cell < 0):
            raise RuntimeError(f"{np.sum(cell < 0)} points are outside the reference mesh")
        origin = corners[cell, 0]
        jacobian = np.stack([corners[cell, 1] - origin, corners[cell, 2] - origin], axis=2)
        inverse = np.linalg.inv(jacobian)
        xi = np.einsum("nij,nj->ni", inverse, x - origin)
        slope = np.einsum("nak,nkj->naj", shape_gradient("triangle", 2, xi), inverse)
        u = np.einsum("na,nad->nd", shape("triangle", 2, xi), values[cell])
        return u, np.einsum("nad,naj->ndj", values[cell], slope)


def measure(simulation, converged, reference):
    """Row of the table: error in the energy norm relative to the solution's, and what a user looks at."""
    problem, u = simulation.problem, simulation.stepper.u
    row = {"converged": converged, "newton": simulation.newton.snes.getIterationNumber()}
    row["krylov"] = simulation.newton.snes.getLinearSolveIterations()
    if not converged:
        return {**row, "error": float("nan"), "force": float("nan"), "max_pressure": float("nan")}
    error = bulk_error(problem.space, CONSTANTS, u, reference)
    contact = problem.contacts[0].summary(u)
    row["error"] = error.energy / error.energy_of_exact
    row["force"], row["max_pressure"] = -contact["force"][1], contact["max_pressure"]
    return row


def solve_reference(directory, h):
    """The reference solution. *Collective.*"""
    path = make_mesh(disk_on_block, Path(directory) / "reference.msh", h)
    with running(scene(path, theta=-1.0, gamma0=1.0, order=2)) as (simulation, converged):
        if not converged:
            raise RuntimeError("the reference did not converge")
        return Reference(simulation)


def sweep(directory, h, reference, thetas=THETAS, gammas=(1.0,), order=1):
    """Rows for all theta and gamma0 on one mesh. *Collective.*"""
    path = make_mesh(disk_on_block, Path(directory) / f"disk_{h:g}.msh", h)
    rows = []
    for theta in thetas:
        for gamma0 in gammas:
            with running(scene(path, theta, gamma0, order)) as (simulation, converged):
                row = measure(simulation, converged, reference)
            rows.append({"h": h, "order": order, "theta": theta, "gamma0": gamma0, **row})
    return rows


def _plot(rows):
    def paint(axes):
        for theta, mark in zip(THETAS, "sov", strict=True):
            for h in sorted({r["h"] for r in rows}, reverse=True):
                own = [r for r in rows if r["theta"] == theta and r["h"] == h]
                line = [r["error"] for r in own]
                axes.loglog([r["gamma0"] for r in own], line, mark + "-", label=f"theta {theta:g}, h {h:g}")
        axes.set_xlabel("gamma0")
        axes.set_ylabel("relative error, energy norm")
        axes.legend(fontsize="small")

    return paint


def run(args):
    """The study; 1 if theta = -1 fails anywhere, since nothing else is promised for every gamma0."""
    sizes = [0.1] if args.tiny else args.h
    gammas = np.logspace(-3, 3, 3 if args.tiny else args.count).tolist()
    reference = solve_reference(args.o, 0.05 if args.tiny else args.reference)
    rows = [r for h in sizes for r in sweep(args.o, h, reference, THETAS, gammas, args.order)]
    keys = ["h", "theta", "gamma0", "converged", "newton", "krylov", "error", "force", "max_pressure"]
    print_table("disk on block", keys, [[r[k] for k in keys] for r in rows])
    for theta in THETAS:
        for h in sizes:
            errors = [r["error"] for r in rows if r["theta"] == theta and r["h"] == h and r["converged"]]
            spread = max(errors) / min(errors) if errors else float("nan")
            log.info("theta %g, h %g: %d of %d converged, largest / smallest error %.3g",
                     theta, h, len(errors), len(gammas), spread)  # fmt: skip
    write_json(args.o / "disk_on_block.json", rows)
    draw(args.o / "disk_on_block.png", _plot(rows))
    return 0 if all(r["converged"] for r in rows if r["theta"] == -1.0) else 1


if __name__ == "__main__":
    parser = make_parser(__doc__, "disk_on_block_results")
    parser.add_argument("--h", type=float, nargs="+", default=[0.1, 0.05, 0.025], help="element sizes")
    parser.add_argument("--count", type=int, default=13, help="values of gamma0 over six decades")
    parser.add_argument("--order", type=int, default=1, help="degree of the displacement")
    parser.add_argument("--reference", type=float, default=0.0125, help="element size of the reference")
    main(run, parser)
