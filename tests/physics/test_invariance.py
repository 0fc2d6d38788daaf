"""What must not matter: the units of the user, and the number of ranks."""

import gmsh
import numpy as np
import pytest

from drivers.cases import disk_on_block as disk
from drivers.cases import patch
from meshes import disk_on_block, two_blocks
from meshes.tools import gmsh_model
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.simulation import Simulation

WORLD = MPI.COMM_WORLD
# units of length and of stress: mm, t, s instead of m, kg, s; then one of them changed, then both
UNITS = [(1e3, 1e-6), (1e-6, 1.0), (1e6, 1.0), (1.0, 1e-6), (1.0, 1e6), (1.0, 1e9), (1e-6, 1e9)]


def scaled(source, path, factor):
    """A mesh file with all coordinates multiplied."""
    with gmsh_model("scaled"):
        gmsh.open(str(source))
        gmsh.model.mesh.affineTransform((factor * np.eye(4)[:3]).ravel().tolist())
        gmsh.option.setNumber("Mesh.Binary", 1)
        gmsh.write(str(path))


def finish(scene, comm, measure):
    """What `measure` makes of a finished run; the run's options leave the database. Collective on `comm`."""
    simulation = Simulation(scene, comm)
    try:
        assert simulation.run()
        return measure(simulation)
    finally:
        simulation.close()


def counts(simulation):
    """Newton and Krylov iterations."""
    snes = simulation.newton.snes
    return snes.getIterationNumber(), snes.getLinearSolveIterations()


def solution(simulation):
    """Iterations, displacement by node of the file, pressure and partners by source point. Collective."""
    space, item, comm = simulation.problem.space, simulation.problem.items[1], simulation.comm
    nodes = space.mesh.file_nodes[space.mesh_nodes]
    parts = comm.allgather((nodes, space.local.gather(simulation.stepper.u)))
    nodes, u = (np.concatenate(part) for part in zip(*parts, strict=True))
    _, first = np.unique(nodes, return_index=True)
    state = item.state(simulation.stepper.u)
    table = partners(item, comm, state["pressure"])
    return counts(simulation), u[first], table["value"], table


def partners(item, comm, value):
    """Who meets whom, in the order of the source facets, the same on every rank. Collective on `comm`."""
    pairing, source = item.pairing, item.source
    own = {
        "source": source.facet_ids[source.facet],
        "target": pairing.ids,
        "paired": pairing.paired,
        "shape": pairing.target_shape,
        "normal": pairing.normal,
        "gap": pairing.gap0,
        "value": value,
    }
    parts = [part for part in comm.allgather(own) if len(part["source"])]
    joined = {key: np.concatenate([part[key] for part in parts]) for key in own}
    # the points of a facet are together and in their order on one rank
    order = np.argsort(joined["source"], kind="stable")
    return {key: array[order] for key, array in joined.items()}


def closeness(a, b):
    """Largest difference relative to the largest value."""
    return np.max(np.abs(a - b)) / np.max(np.abs(b))


# -- units --------------------------------------------------------------------------------------------------


def patch_case(path, length, stress):
    return patch.scene(path, 3, length=length, stress=stress, petsc={"snes_rtol": "1e-12"})


def disk_case(path, length, stress):
    case = disk.scene(path, 0.0, petsc={"snes_rtol": "1e-12", "pc_type": "gamg"})
    for material in case.materials.values():
        material.E *= stress
    for load in case.loads:
        load.body_force = [f * stress / length for f in load.body_force]
    return case


def patch_mesh(path):
    two_blocks(path, 3, 3, 4)


def disk_mesh(path):
    disk_on_block(path, 0.05)


@pytest.mark.parametrize(
    ("mesh", "case"), [(patch_mesh, patch_case), (disk_mesh, disk_case)], ids=["patch", "disk"]
)
def test_units_do_not_matter(tmp_path, mesh, case):
    mesh(tmp_path / "one.msh")
    first, u, pressure, _ = finish(case(tmp_path / "one.msh", 1.0, 1.0), WORLD, solution)
    for length, stress in UNITS:
        path = tmp_path / "other.msh"
        scaled(tmp_path / "one.msh", path, length)
        second, other_u, other_pressure, _ = finish(case(path, length, stress), WORLD, solution)
        assert second == first, (length, stress)
        assert closeness(other_u / length, u) < 1e-9
        assert closeness(other_pressure / stress, pressure) < 1e-9


def test_the_unit_of_time_does_not_matter(tmp_path):
    disk_mesh(tmp_path / "disk.msh")
    answers = []
    for end in (1.0, 1e6, 1e-6):
        case = disk_case(tmp_path / "disk.msh", 1.0, 1.0)
        case.steps.end, case.steps.count, case.steps.min_step = end, 3, 0.3 * end
        answers.append(finish(case, WORLD, solution))
    for other in answers[1:]:
        assert other[0] == answers[0][0]
        assert closeness(other[1], answers[0][1]) < 1e-12


# -- ranks --------------------------------------------------------------------------------------------------


def rank_case(folder, name):
    """Mesh and scene of a case. Collective."""
    path = folder / "mesh.msh"
    tight = {"snes_rtol": "1e-12"}
    if name == "disk":
        on_root(WORLD, disk_on_block, path, 0.05)
        return disk.scene(path, 0.0, petsc={**tight, "pc_type": "gamg"})
    # source points on the edges and vertices of target facets: 3 above 2 with an odd number of points
    cell, dim, order = {
        "quadrilaterals": ("quadrilateral", 2, 1),
        "quadratic triangles": ("triangle", 2, 2),
        "hexahedra": ("hexahedron", 3, 1),
        "tetrahedra": ("tetrahedron", 3, 1),
    }[name]
    on_root(WORLD, two_blocks, path, dim, 2, 3, cell)
    return patch.scene(path, dim, order, quadrature=5, petsc=tight)


CASES = ["disk", "quadrilaterals", "quadratic triangles", "hexahedra", "tetrahedra"]


@pytest.mark.parallel
@pytest.mark.parametrize("name", CASES)
def test_ranks_do_not_matter(shared_tmp, name):
    """Against the same scene on one rank."""
    case = rank_case(shared_tmp, name)
    first, u, pressure, partner = finish(case, MPI.COMM_SELF, solution)
    WORLD.Barrier()
    case = rank_case(shared_tmp, name)
    second, other_u, other_pressure, other_partner = finish(case, WORLD, solution)
    assert abs(second[0] - first[0]) <= 1
    assert closeness(other_u, u) < 1e-9
    assert closeness(other_pressure, pressure) < 1e-9
    for key in ("source", "target", "paired"):
        assert np.array_equal(other_partner[key], partner[key]), key
    for key in ("shape", "normal"):
        assert np.max(np.abs(other_partner[key] - partner[key])) < 1e-12, key
