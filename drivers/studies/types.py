"""Types of matrices: what a product and a linear solve take with each, on one matrix in turn.

    mpirun -n 2 python drivers/studies/types.py -o types --unknowns 50000 200000 [--types aij baij sell]

The matrix is the stiffness of the ball and the block of `meshes.ball_on_block` (tetrahedra of degree 1) under body
forces; solves go to a relative tolerance of 1e-8 with the program's Krylov method and multigrid. `run` is a whole load
step of the two in contact with friction. Seconds are processor seconds of the slowest rank. Types take
turns, and the fastest of all turns counts, so that what else the machine does disturbs the ratios to the first type
little; `spread` is the slowest turn of that type over its fastest.
"""

import time

import numpy as np

from drivers._common import main, make_mesh, make_parser, print_table, write_json
from drivers.studies._press import make_scene
from meshes import ball_on_block
from pcontact.assembly.matrix import AIJ, BESIDE
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI, PETSc, known_types
from pcontact.simulation import Simulation

PRODUCTS = 20  # in a turn
TIMED = ("product", "set_up", "solve", "run")
KINDS = known_types(PETSc.Mat, (*AIJ, *BESIDE))


def seconds(work) -> float:
    """Of a collective piece of work, on the slowest rank. *Collective.*"""
    comm = MPI.COMM_WORLD
    comm.Barrier()
    start = time.process_time()
    work()
    return comm.allreduce(time.process_time() - start, op=MPI.MAX)


class Case:
    """The linear system of a mesh, with its operator in a type. *Collective.*"""

    def __init__(self, mesh, kind):
        scene = make_scene(mesh, "linear", theta=1.0)
        scene.petsc["mat_type"] = kind
        self._simulation = Simulation(scene)
        problem, self._ksp = self._simulation.problem, self._simulation.newton.snes.getKSP()
        problem.time = 1.0
        u = problem.space.vector()
        problem.prediction.begin(u, 1.0)
        problem.tangent(u)
        self.unknowns = problem.space.n_dofs
        self._matrix, self._right = problem.matrix.operator, problem.matrix.operator.createVecLeft()
        problem.residual(u, self._right)
        self._x = self._matrix.createVecRight()
        self._ksp.setOperators(self._matrix, problem.matrix.matrix)

    def products(self):
        """As many as `PRODUCTS`."""
        for _ in range(PRODUCTS):
            self._matrix.mult(self._right, self._x)

    def renew(self):
        """Have the next :meth:`set_up` begin anew."""
        self._ksp.reset()
        self._ksp.setOperators(self._matrix, self._simulation.problem.matrix.matrix)

    def set_up(self):
        """Multigrid."""
        self._ksp.setUp()

    def solve(self):
        """The linear system."""
        self._ksp.solve(self._right, self._x)

    @property
    def iterations(self) -> int:
        """Of the last solve."""
        return self._ksp.getIterationNumber()

    def close(self):
        """Give everything back. *Collective.*"""
        self._simulation.free()


class Contact:
    """A load step with contact and friction. *Collective.*"""

    def __init__(self, mesh, kind):
        self._scene = make_scene(mesh, "frictional")
        self._scene.petsc["mat_type"] = kind

    def run(self):
        """From the mesh to the solution."""
        simulation = Simulation(self._scene)
        if not simulation.run(None):
            raise SystemExit(1)
        self.memory = simulation.costs.memory()["solve"]["peak_mb"]
        simulation.free()


def turn(mesh, kind) -> dict:
    """Seconds of a product, of the set-up, of a solve, of a run, and its peak memory [MB]; iterations; unknowns.
    *Collective.*"""
    case = Case(mesh, kind)
    row = {"product": seconds(case.products) / PRODUCTS}
    case.renew()
    row["set_up"], row["solve"] = seconds(case.set_up), seconds(case.solve)
    row.update(iterations=case.iterations, unknowns=case.unknowns)
    case.close()
    contact = Contact(mesh, kind)
    row.update(run=seconds(contact.run), memory=contact.memory)
    return row


def compare(args) -> int:
    """Tables of all sizes; the exit status."""
    wrong = [kind for kind in args.types if kind not in KINDS]
    if wrong:
        raise InputError(f"command line: --types: found {wrong[0]!r}; allowed: {' '.join(KINDS)}")
    result = {"ranks": MPI.COMM_WORLD.size, "sizes": []}
    for size in [1500] if args.tiny else args.unknowns:
        mesh = args.o / f"ball_{size}.msh"
        if not MPI.COMM_WORLD.bcast(mesh.exists()):
            make_mesh(ball_on_block, mesh, unknowns=size)
        turns = {kind: [] for kind in args.types}
        for _ in range(1 if args.tiny else args.repeat):
            for kind, rows in turns.items():
                rows.append(turn(mesh, kind))
        best = {kind: {name: min(row[name] for row in rows) for name in rows[0]} for kind, rows in turns.items()}
        first = args.types[0]
        spread = {name: max(row[name] for row in turns[first]) / best[first][name] for name in TIMED}
        print_table(
            f"{best[first]['unknowns']} unknowns, {MPI.COMM_WORLD.size} ranks; spread of {first}: product "
            f"{spread['product']:.2f}, solve {spread['solve']:.2f}, run {spread['run']:.2f}",
            ["type", "iterations", *np.ravel([(f"{name} [s]", "ratio") for name in TIMED]), "memory [MB]"],
            [
                [kind, row["iterations"], *np.ravel([(row[name], row[name] / best[first][name]) for name in TIMED]),
                 row["memory"]]
                for kind, row in best.items()
            ],
        )  # fmt: skip
        result["sizes"].append({"unknowns": best[first]["unknowns"], "spread": spread, "types": best})
        write_json(args.o / "types.json", result)
    return 0


if __name__ == "__main__":
    parser = make_parser(__doc__, "types")
    parser.add_argument("--unknowns", type=int, nargs="+", default=[50_000, 200_000], metavar="N")
    parser.add_argument("--types", nargs="+", default=["aij", "baij", "sell"], metavar="TYPE")
    parser.add_argument("--repeat", type=int, default=5, metavar="N", help="turns of each type (default: %(default)s)")
    main(compare, parser)
