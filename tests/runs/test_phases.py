"""Phases of a run: supports that let go, screws that friction holds, surfaces that tie; ranks, restart, refusals."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from meshes.blocks import one_block, two_blocks
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import (
    Body,
    Contact,
    Coupling,
    Displacement,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Phase,
    Scene,
    Spring,
)
from pcontact.simulation import Simulation
from tests.support.restarts import KeepAll, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel
E = 100.0
EXACT = {"snes_rtol": "1e-12", "ksp_rtol": "1e-13"}


@pytest.fixture
def mesh(shared_tmp):
    paths = {name: shared_tmp / f"{name}.msh" for name in ("bar", "blocks")}
    if WORLD.rank == 0:
        one_block(paths["bar"], 2, 3)
        two_blocks(paths["blocks"], 2, 3, 2)
    WORLD.Barrier()
    return paths


def bar(path, phases, displacements, **more):
    """A square block that is held on its left and may contract."""
    sides = [Displacement("left", [0, "free"]), Displacement("origin", ["free", 0])]
    return Scene(
        MeshSpec(path), {"m": Material(E, 0.3)}, [Body("block", "m")], displacements=[*sides, *displacements],
        phases=phases, petsc=EXACT, output=Output(fields=False, checkpoint=True), **more,
    )  # fmt: skip


def simulated(case, comm=SELF):
    simulation = Simulation(case, comm)
    assert simulation.run(keep=True)
    simulation.close()
    return simulation, simulation.records.data()["steps"]


def displacement(simulation):
    space = simulation.problem.space
    x = space.points[space.owned_local]
    return x, simulation.stepper.u.getArray(readonly=True).reshape(x.shape)


def stiffness(nu=0.3):
    """Force over stretch of the bar in plane strain."""
    return E / (1.0 - nu**2)


def test_a_prestressed_bar_springs_back(mesh):
    """The reaction of the support that lets go falls linearly to zero, and the bar with it."""
    case = bar(mesh["bar"], [Phase("stretch"), Phase("let go", 2.0, 4), Phase("rest")],
               [Displacement("right", [0.1, "free"], phases=["stretch"])])  # fmt: skip
    simulation, steps = simulated(case)
    assert [step["phase"] for step in steps] == ["stretch", *["let go"] * 4, "rest"]
    assert [step["time"] for step in steps] == [1.0, 1.5, 2.0, 2.5, 3.0, 4.0]
    force = 0.1 * stiffness()
    held = [step["reactions"]["left"][0] for step in steps]
    np.testing.assert_allclose(held, -force * np.array([1, 0.75, 0.5, 0.25, 0, 0]), atol=1e-10)
    np.testing.assert_allclose([step["released"]["force"][0] for step in steps[1:]],
                               force * np.array([0.75, 0.5, 0.25, 0, 0]), atol=1e-10)  # fmt: skip
    assert "right" in steps[0]["reactions"] and "right" not in steps[1]["reactions"] and "released" not in steps[0]
    assert max(step["imbalance"] for step in steps) < 1e-10
    np.testing.assert_allclose(displacement(simulation)[1], 0.0, atol=1e-12)


def test_a_support_that_is_added_holds_what_has_moved(mesh):
    """A second support moves its group on from where the load has brought it; the load goes, and both hold it."""
    case = bar(mesh["bar"], [Phase("pull", 1.0, 2), Phase("hold"), Phase("unload", 1.0, 2), Phase("free")],
               [Displacement("right", [0.02, "free"], phases=["unload"]),
                Displacement("right", [0.0, "free"], phases=["hold"])],
               loads=[Load("right", traction=[5.0, 0.0], phases=["pull", "hold"])])  # fmt: skip
    _, steps = simulated(case)
    record = {step["time"]: step for step in steps}
    np.testing.assert_allclose(record[2.0]["reactions"]["right"][0], 0.0, atol=1e-10)
    np.testing.assert_allclose(record[3.0]["reactions"]["right"][0], 5.0 + 0.02 * stiffness(), rtol=1e-9)
    np.testing.assert_allclose(record[2.5]["reactions"]["right"][0], 2.5 + 0.01 * stiffness(), rtol=1e-9)
    np.testing.assert_allclose(record[4.0]["reactions"]["left"][0], 0.0, atol=1e-10)


@pytest.mark.parametrize("average", [False, True])
def test_half_of_a_load_is_left_half_way(mesh, average):
    """A traction ends; of all forces half is left in the middle of the phase, also on nodes that a coupling holds."""
    case = bar(mesh["bar"], [Phase("load"), Phase("unload", count=2)], [Displacement("left", [0, 0])],
               loads=[Load("top", traction=[0.2, 0.5], phases=["load"])],
               couplings=[Coupling("right", displacement=[0, 0], rotation=0.0, average=average)])  # fmt: skip
    case.displacements = case.displacements[2:]
    _, (whole, half, none) = simulated(case)
    for step, part in ((half, 0.5), (none, 0.0)):
        found, wanted = (np.array([*one["reactions"]["left"], *one["couplings"]["right"]["force"],
                                   one["couplings"]["right"]["moment"]]) for one in (step, whole))  # fmt: skip
        np.testing.assert_allclose(found, part * wanted, atol=1e-10)
        np.testing.assert_allclose(step["released"]["force"], part * np.array([0.2, 0.5]), atol=1e-10)
        assert step["imbalance"] < 1e-10


def test_energies_of_phases(mesh):
    """A spring joins and goes: works are those of the forces at both ends of a load step, whatever their number, and
    what the spring has taken up stays in the balance."""
    ends = []
    for count in (2, 5):
        case = bar(mesh["bar"], [Phase("pull"), Phase("with spring", count=count), Phase("without")], [],
                   loads=[Load("right", traction=[5.0, 0.0], phases=["pull"]), Load("right", traction=[1.0, 0.0])],
                   springs=[Spring("right", stiffness=[50.0, 0.0], phases=["with spring"])])  # fmt: skip
        case.output.energy = True
        _, steps = simulated(case)
        assert max(abs(step["energy"]["defect"]) for step in steps) < 1e-9
        ends.append([steps[-1]["energy"][name] for name in ("loads", "springs", "stored")])
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-8)
    assert ends[0][1] < 0.0, "it has been drawn as far as the bar was, and given back"


def test_springs_and_loads_of_a_phase(mesh):
    """A spring that joins a stretched bar takes its part over the phase, and gives it back when it goes."""
    case = bar(mesh["bar"], [Phase("pull"), Phase("with spring", 1.0, 2), Phase("without")], [],
               loads=[Load("right", traction=[5.0, 0.0], phases=["pull", "with spring", "without"])],
               springs=[Spring("right", stiffness=[50.0, 0.0], phases=["with spring"])])  # fmt: skip
    _, steps = simulated(case)
    alone, k = 5.0 / stiffness(), stiffness()
    both = (5.0 + np.array([50.0 * alone * 0.5, 0.0])) / (k + 50.0)
    forces = [-step["springs"]["right"]["force"][0] for step in steps if step["phase"] == "with spring"]
    np.testing.assert_allclose(forces, 50.0 * both, rtol=1e-9)
    assert "springs" not in steps[0] and "springs" not in steps[-1]
    np.testing.assert_allclose([step["reactions"]["left"][0] for step in steps][-1], -5.0, rtol=1e-9)


# -- contact -----------------------------------------------------------------------------------------------------------


def blocks(path, phases, contact, displacements, **more):
    """A block on another one whose sides are held: uniaxial strain."""
    held = [Displacement("lower_bottom", [0, 0]), Displacement("upper_left", [0, "free"]),
            Displacement("upper_right", [0, "free"])]  # fmt: skip
    return Scene(
        MeshSpec(path), {"m": Material(E, 0.0)}, [Body("lower", "m"), Body("upper", "m")],
        [Contact("upper_bottom", "lower_top", name="joint", **contact)], displacements=[*held, *displacements],
        phases=phases, petsc=EXACT, output=Output(fields=False, checkpoint=True), **more,
    )  # fmt: skip


KINDS = [{}, {"theta": 1.0, "friction": 0.2}, {"formulation": "penalty"}, {"unbiased": True}]


@pytest.mark.parametrize("contact", KINDS)
def test_surfaces_that_tie_when_they_are_closed_take_tension(mesh, contact):
    """Pressed by 0.1, tied, drawn up by 0.3 in all: a bar of two blocks in tension, and without the tie nothing."""
    case = blocks(
        mesh["blocks"], [Phase("press", 1.0, 2), Phase("draw", 1.0, 2, tied=["joint"]), Phase("part", 1.0, 2)], contact,
        [Displacement("upper_top", [0, -0.1], [[0, 0], [1, 1], [2, -2]])],
    )  # fmt: skip
    _, steps = simulated(case)
    force = [step["reactions"]["upper_top"][1] for step in steps]
    # linear in the displacement, with springs between the blocks as well
    k = force[0] / -0.05
    assert k == pytest.approx(0.5 * E, rel=1e-8) or (contact.get("formulation") == "penalty" and k < 0.5 * E)
    np.testing.assert_allclose(force[:4], k * np.array([-0.05, -0.1, 0.05, 0.2]), rtol=1e-8)
    assert all(step["contacts"]["joint"]["stick"] > 0 for step in steps[2:4])
    np.testing.assert_allclose(force[4:], [0.5 * force[3], 0.0], atol=1e-9)
    assert steps[5]["contacts"]["joint"]["area"] == 0.0


@pytest.mark.parametrize("strain", ["small", "finite"])
def test_what_is_open_between_tied_surfaces_stays_so(mesh, strain):
    """Pressed together on the right, tied, and pressed all over: on the left surfaces go into each other, of which no
    search for partners makes contact."""
    top = Displacement("upper_top", [0, "-0.02*(2*x - 1)*min(t, 1) - 0.1*max(t - 1, 0)"])
    case = blocks(mesh["blocks"], [Phase("press"), Phase("sink", 1.0, 2, tied=["joint"])], {}, [top])
    case.bodies = [Body(name, "m", strain=strain) for name in ("lower", "upper")]
    _, steps = simulated(case)
    joint = [step["contacts"]["joint"] for step in steps]
    assert 0 < joint[1]["stick"] == joint[2]["stick"] == joint[0]["slip"] and joint[2]["open"] == joint[0]["open"] > 0
    assert steps[2]["partners"]["unsettled"] == [] and steps[2]["newton"] <= 4


@pytest.mark.parametrize("moved", [0.1, -0.1])
def test_a_tie_of_surfaces_that_are_apart_is_told(mesh, moved):
    log.forget_warnings()
    phases = [Phase("before"), Phase("after", tied=["joint"])]
    simulated(blocks(mesh["blocks"], phases, {}, [Displacement("upper_top", [0, moved], [[0, 0], [1, 1]])]))
    told = [line for line in log.warnings() if "after" in line and "joint" in line and "tied" in line]
    assert len(told) == (moved > 0.0)


def test_friction_holds_what_has_been_tightened_without(mesh):
    """A block that is pressed on a floor and drawn along without friction bears nothing along it. With friction from
    then on it stays where it is when the support lets go, but for what springs of more than F N can draw it back;
    without it again it goes back all the way.
    """
    floor = Contact("bottom", obstacle=Obstacle("plane", [0.0, 0.0], [0.0, 1.0]), name="floor")
    case = Scene(
        MeshSpec(mesh["bar"]), {"m": Material(E, 0.0)}, [Body("block", "m")], [floor],
        [Displacement("top", ["free", -0.1], [[0, 0], [1, 1]]),
         Displacement("top", [0.04, "free"], [[1, 0], [2, 1]], phases=["press", "tighten"])],
        phases=[Phase("press"), Phase("tighten", 1.0, 2, {"floor": 0.0}), Phase("let go", 1.0, 4),
                Phase("oil", 1.0, 2, {"floor": 0.0})], petsc=EXACT,
    )  # fmt: skip
    forces = {}
    for stiffness, friction in ((10.0, 0.3), (200.0, 0.05)):
        floor.friction = friction
        _, steps = simulated(replace(case, springs=[Spring("top", stiffness=[stiffness, 0.0])]))
        last = {step["phase"]: step for step in steps}
        # on the target
        joint = {name: step["contacts"]["floor"]["force"] for name, step in last.items()}
        springs = {name: step["springs"]["top"]["force"][0] for name, step in last.items()}
        assert abs(joint["tighten"][0]) < 1e-9 and springs["tighten"] == pytest.approx(-0.04 * stiffness, rel=1e-9)
        assert springs["let go"] == pytest.approx(joint["let go"][0], rel=1e-8)
        assert abs(joint["oil"][0]) < 1e-8 and abs(springs["oil"]) < 1e-8
        assert max(step["imbalance"] for step in steps) < 1e-8
        forces[stiffness] = joint["let go"]
    # soft springs give back what the block, a beam that sticks, is stiffer by: 1/k = L^3/12EI + L/(5/6 GA)
    beam = 1.0 / (1.0 / E + 1.0 / (5.0 / 6.0 * 0.5 * E))
    assert -forces[10.0][0] == pytest.approx(0.4 * beam / (beam + 10.0), rel=0.03)
    # stiff ones draw with all that friction bears
    assert forces[200.0][0] == pytest.approx(0.05 * forces[200.0][1], rel=1e-6)


def prestressed(path):
    """Pressed and sheared with friction, tied, and let go."""
    phases = [Phase("press", 1.0, 2), Phase("tie", 1.0, 2, tied=["joint"]), Phase("let go", 1.0, 3)]
    case = blocks(path, phases, {"friction": 0.3}, [])
    case.displacements = [
        Displacement("lower_bottom", [0, 0]),
        Displacement("upper_top", [0.01, -0.05], [[0, 0], [1, 1], [2, 0.5]], phases=["press", "tie"]),
    ]
    return case


def same(steps, others):
    """Whether the numbers of two runs are the same."""
    for one, other in zip(steps, others, strict=True):
        assert (one["phase"], one["time"]) == (other["phase"], other["time"])
        for table in ("reactions", "contacts"):
            for name, values in one[table].items():
                values, found = (entry["force"] if table == "contacts" else entry
                                 for entry in (values, other[table][name]))  # fmt: skip
                np.testing.assert_allclose(found, values, atol=1e-8)
        if "released" in one:
            np.testing.assert_allclose(other["released"]["force"], one["released"]["force"], atol=1e-8)


@parallel(1, 2, 3)
def test_ranks_do_not_matter(mesh):
    """Every force of every step."""
    same(simulated(prestressed(mesh["blocks"]))[1], simulated(prestressed(mesh["blocks"]), WORLD)[1])


@parallel(1, 2)
def test_restart_in_a_phase_and_at_its_end(mesh, shared_tmp):
    """The numbers of the whole run, from a checkpoint in the first phase, at its end, and within the others."""
    folder = shared_tmp / "whole"
    steps = run(prestressed(mesh["blocks"]), WORLD, folder, [KeepAll(folder, shared_tmp, WORLD)])
    for stop in (1, 2, 3, 4, 6):
        rest = run(prestressed(mesh["blocks"]), WORLD, shared_tmp / f"rest{stop}", restart=shared_tmp / str(stop))
        same(steps[stop:], rest)


def test_a_restart_may_begin_another_phase(mesh, shared_tmp):
    """From the end of a phase on others may follow; those that have been run are as they were."""
    folder, case = shared_tmp / "first", prestressed(mesh["blocks"])
    run(case, SELF, folder, [KeepAll(folder, shared_tmp, SELF)])
    other = prestressed(mesh["blocks"])
    other.phases[2:] = [Phase("oil", 1.0, 2, {"joint": 0.0})]
    other.displacements.append(Displacement("upper_top", [0.0, 0.0], phases=["oil"]))
    steps = run(other, SELF, shared_tmp / "other", restart=shared_tmp / "4")
    assert [step["phase"] for step in steps] == ["oil"] * 2
    along, across = steps[-1]["contacts"]["joint"]["force"]
    assert across == pytest.approx(-1.25, rel=1e-2) and abs(along) < 0.002 * abs(across)
    other.phases[1] = Phase("tie", 1.0, 2)
    with pytest.raises(InputError, match="phases\\[1\\].*held"):
        run(other, SELF, shared_tmp / "third", restart=shared_tmp / "4")


def test_a_run_without_phases_is_a_first_phase(mesh, shared_tmp):
    """Its checkpoint is one of a scene whose first phase says the same."""
    whole = bar(mesh["bar"], [], [Displacement("right", [0.1, "free"])])
    folder = shared_tmp / "plain"
    run(whole, SELF, folder)
    case = bar(mesh["bar"], [Phase("stretch"), Phase("let go", 1.0, 2)],
               [Displacement("right", [0.1, "free"], phases=["stretch"])])  # fmt: skip
    steps = run(case, SELF, shared_tmp / "on", restart=folder)
    np.testing.assert_allclose([step["reactions"]["left"][0] for step in steps], [-0.05 * stiffness(), 0], atol=1e-10)


def test_history_has_the_columns_of_all_phases(mesh, shared_tmp):
    """A column for what acts in any phase, empty in the others."""
    pull = Displacement("right", [0.1, "free"], phases=["stretch"])
    case = bar(mesh["bar"], [Phase("stretch"), Phase("let go")], [pull])
    run(case, SELF, shared_tmp / "table")
    with open(shared_tmp / "table" / "history.csv", newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["phase"] for row in rows] == ["stretch", "let go"]
    assert rows[0]["released.force_x"] == "" and float(rows[1]["released.force_x"]) == 0.0
    assert rows[1]["reactions.right_x"] == "" and float(rows[0]["reactions.right_x"]) > 0.0
