"""A scene pays nothing for physics that it does not use: its counters are those of a program that does not have it.

Each piece of physics is taken out of the program: whatever its modules define, wherever it has been imported, is
replaced by something that fails when it is called. A scene without the piece must run, with the same counters.
"""

import inspect
import sys
from dataclasses import replace

import meshio
import numpy as np
import pytest
from numba.core.registry import CPUDispatcher

from meshes.blocks import two_blocks
from pcontact.contact.formulation.small import SmallTerms
from pcontact.element.reference import facet_nodes
from pcontact.io.costs import cost_forecast, friction_bytes, held, plastic_bytes
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import (
    Contact,
    Coupling,
    Dynamics,
    Load,
    Obstacle,
    Periodic,
    Phase,
    Pretension,
    Spring,
    Temperature,
)
from pcontact.simulation import Simulation
from tests.support.lean import PIECES, scene

WORLD = MPI.COMM_WORLD
def section(path):
    """The mesh with a group "cut" across the lower block."""
    old, new = meshio.read(path), path.with_name("cut.msh")
    facets = [cell[facet] for block in old.cells if block.type == "hexahedron" for cell in block.data
              for facet in facet_nodes("hexahedron", 1)]  # fmt: skip
    quads = {tuple(sorted(facet)): facet for facet in facets if np.allclose(old.points[facet, 2], 0.5)}
    tags = {name: [*parts, np.full(len(quads), 99)] for name, parts in old.cell_data.items()}
    cells = [*((block.type, block.data) for block in old.cells), ("quad", np.array(list(quads.values())))]
    mesh = meshio.Mesh(old.points, cells, cell_data=tags, field_data={**old.field_data, "cut": np.array([99, 2])})
    meshio.write(new, mesh, "gmsh22", binary=False)
    return new


def with_piece(path, piece):
    """The scene with a piece of physics."""
    lowest = Contact("lower_bottom", obstacle=Obstacle("plane", [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]), name="floor")
    if piece == "plasticity":
        result = scene(path)
        result.bodies = [replace(body, material="yields") for body in result.bodies]
        return result
    if piece == "obstacles":
        result = scene(path)
        result.contacts.append(lowest)
        return result
    if piece == "finite shapes":
        result = scene(path)
        result.contacts.append(replace(lowest, obstacle=Obstacle("punch", [0.5, 0.5, 0.0], [0, 0, 1], radius=0.4)))
        return result
    if piece == "rigid meshes":
        result = scene(path)
        result.contacts.append(replace(lowest, obstacle=Obstacle("mesh", file=path, region="lower_bottom")))
        return result
    if piece == "pressure that follows":
        result = scene(path)
        result.loads = [Load("upper_left", pressure=0.01, follower=True)]
        return result
    if piece == "thermal strain":
        result = scene(path)
        result.temperatures, result.materials["soft"].expansion = [Temperature(1.0)], 1e-5
        return result
    if piece == "fields of files":
        result, points = scene(path), meshio.read(path).points
        on_root(WORLD, meshio.write, path.with_name("heat.vtu"), meshio.Mesh(
            points, [("vertex", np.arange(len(points))[:, None])], point_data={"T": np.ones(len(points))}))
        WORLD.Barrier()
        heat = Temperature(file=path.with_name("heat.vtu"), field="T")
        result.temperatures, result.materials["soft"].expansion = [heat], 1e-5
        return result
    if piece == "rigid groups":
        result = scene(path)
        result.displacements, result.couplings = result.displacements[:1], [Coupling("upper_top")]
        return result
    if piece == "pre-tension":
        result = scene(section(path))
        result.pretensions = [Pretension("cut", shortening=0.001)]
        return result
    if piece == "equations":
        result = scene(path)
        result.displacements = result.displacements[:1]
        result.periodic = [Periodic("upper_top", "upper_top", angle=90.0, point=[0.5, 0.5, 0.0], axis=[0, 0, 1])]
        return result
    if piece == "phases":
        result = scene(path)
        result.phases = [Phase("press", count=1), Phase("hold", count=1)]
        return result
    if piece == "bodies that come and go":
        result = scene(path)
        result.phases, result.bodies[1].phases = [Phase("press", count=1), Phase("hold", count=1)], ["hold"]
        return result
    if piece == "springs":
        result = scene(path)
        result.springs = [Spring("upper_left", per_area=0.01)]
        return result
    if piece == "viscous stabilisation":
        result = scene(path)
        result.steps.viscous_stabilisation = 1e-3
        return result
    if piece == "inertia":
        result = scene(path)
        result.dynamics, result.materials["soft"].density = Dynamics(), 1.0
        return result
    if piece == "mean dilatation":
        result = scene(path)
        result.mesh.mean_dilatation = True
        return result
    if piece == "contact that moves":
        result = scene(path)
        result.mesh.strain = "finite"
        return result
    if piece == "finite strain":
        result = scene(path)
        result.mesh.strain, result.contacts = "finite", []
        return result
    return scene(path, **{
        "friction": {"friction": 0.4},
        "friction that varies": {"friction": "0.4 + 0*x"},
        "self contact": {"source": "upper_bottom", "target": "upper_bottom", "self_contact": True},
        "all surfaces": {"source": None, "target": None, "all": True},
        "tied surfaces": {"tied": True},
        "unbiased contact": {"unbiased": True},
        "penalty": {"formulation": "penalty"},
        "augmented Lagrangian": {"formulation": "augmented_lagrangian"},
        "soft layers": {"pressure_overclosure": 1000.0},
        "initial gaps": {"clearance": 0.001},
    }[piece])  # fmt: skip


def take_out(monkeypatch, piece):
    """Replace a piece of physics, in all modules that know it, by something that fails."""
    modules, kept = PIECES[piece]
    gone = {}
    for name in modules:
        name, _, only = name.partition(":")
        module = sys.modules[f"pcontact.{name}"]
        for key, thing in vars(module).items():
            own = getattr(thing, "__module__", None) == module.__name__ and only in ("", key)
            if own and key not in kept and (inspect.isclass(thing) or callable(thing)):
                gone[id(thing)] = thing
    replaced = 0
    for module in [module for name, module in sys.modules.items() if name.startswith("pcontact")]:
        for key, thing in list(vars(module).items()):
            if id(thing) not in gone:
                continue
            replaced += 1
            if inspect.isclass(thing):
                # those derived from it go with it, and tables that hold it
                monkeypatch.setattr(thing, "__init__", _missing(piece, key))
            else:
                # a kernel that other kernels call is compiled already
                monkeypatch.setattr(module, key, _missing(piece, key))
    assert replaced >= len(gone) > 0


def _missing(piece, key):
    def fail(*arguments, **named):
        raise AssertionError(f"{piece}: {key} was called")

    return fail


def counters(case, comm=WORLD):
    """Counters of a run, and messages and points searched."""
    simulation = Simulation(case, comm)
    try:
        assert simulation.run(None)
        counts, parallel = simulation.counters(), simulation.costs.parallel()
        sent = {name: entry["messages"] for name, entry in parallel["exchange"].items()}
        return {**counts, "search": parallel["search"], "messages": sent}
    finally:
        simulation.close()


@pytest.fixture
def mesh(shared_tmp):
    path = shared_tmp / "blocks.msh"
    on_root(WORLD, two_blocks, path, 3, 2, 3, "hexahedron")
    return path


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("piece", list(PIECES))
def test_what_is_left_out_costs_nothing(mesh, piece, monkeypatch):
    # what compiles, or is read from a cache, does so here
    counters(scene(mesh))
    before = counters(scene(mesh))
    take_out(monkeypatch, piece)
    assert counters(scene(mesh)) == before


@pytest.mark.parametrize("piece", list(PIECES))
def test_what_is_used_is_counted(mesh, piece, monkeypatch):
    """The other way round: a scene with the piece has other counters, and does not run without it."""
    case = with_piece(mesh, piece)
    assert counters(case)["bytes"] != counters(scene(mesh))["bytes"]
    take_out(monkeypatch, piece)
    with pytest.raises(AssertionError, match=piece):
        counters(with_piece(mesh, piece))


@pytest.mark.parallel(2, 3)
def test_elastic_frictionless_contact_has_no_state(mesh):
    """What is committed is the status of the points; nothing tangential, nothing plastic, in any item."""
    simulation = Simulation(scene(mesh), WORLD)
    simulation.run(None)
    bulk, pair = simulation.problem.items
    shared = simulation.problem.space, simulation.mesh
    assert type(pair.terms) is SmallTerms
    assert not {name for name in held(bulk, shared) if "state" in name or "strain" in name}
    tangential = ("lag", "start", "before", "law", "slip", "tangent", "multiplier")
    assert not [name for name in held(pair, shared) if any(word in name for word in tangential)]
    kernels = simulation.counters()["kernels"]
    others = ("strains.add_forces", "strains.add_stiffness")
    assert not [name for name in kernels if name.startswith(("law.", "plastic.", *others))]
    simulation.close()


def test_kernels_are_counted():
    """Kernels called from Python count, all kinds of decorator."""
    from_python = [thing for thing in vars(sys.modules["pcontact.contact.formulation.small_kernels"]).values()
                   if isinstance(thing, CPUDispatcher)]  # fmt: skip
    assert from_python and all(hasattr(kernel, "title") for kernel in from_python)


@pytest.mark.parallel(2, 3)
def test_what_check_foretells(mesh):
    """State of friction and plasticity, in bytes."""
    plain, rough, yielding = (counters(case) for case in (
        scene(mesh), with_piece(mesh, "friction"), with_piece(mesh, "plasticity")
    ))  # fmt: skip
    points, rows = plain["points"]["pair"], plain["bytes"]["pair"]["pairs.pairing.operator.rows"]
    # its row, and the directions of space
    law = (24 + 72) * WORLD.size
    # the slip of one more direction may couple other points, hence other patterns
    patterns = ("columns", "rowptr", "owned.")
    others = {name for name in rough["bytes"]["pair"] if not name.startswith(patterns)}
    more = sum(rough["bytes"]["pair"][name] - plain["bytes"]["pair"].get(name, 0) for name in others)
    assert more == friction_bytes(3, rows / points) * points + law
    (name,) = set(yielding["points"]) - {"pair"}
    state = {key: size for key, size in yielding["bytes"][name].items() if key == "states.values"}
    assert len(state) == 1 and sum(state.values()) == plastic_bytes(3) * yielding["points"][name]


def test_prices_of_what_is_left_out(mesh):
    simulation = Simulation(scene(mesh))
    for item in simulation.problem.items:
        item.detect(simulation.problem.space.vector(), 0.0, 0.0)
    lines = " ".join(cost_forecast(simulation.problem, simulation.scene))
    assert all(f"more with {piece}" in lines for piece in ("friction", "plasticity", "finite strain", "unbiased"))
    simulation.scene.contacts[0].friction = 0.2
    assert "more with friction" not in " ".join(cost_forecast(simulation.problem, simulation.scene))
    simulation.close()


def test_numbers_are_no_expressions(mesh, monkeypatch):
    """Loads that are numbers parse nothing and are integrated once, without averages over their groups."""
    case = scene(mesh)
    case.loads = [Load("upper_left", pressure=0.01), Load("upper", body_force=[0.0, 0.01, 0.0])]
    for name in ("scene.functions.Expression", "build.TimedLoad", "build.TotalLoad"):
        monkeypatch.setattr(f"pcontact.{name}", _missing("expressions", name))
    counters(case)
    case.loads[0].pressure = "0.01*t"
    with pytest.raises(AssertionError, match="expressions"):
        counters(case)
