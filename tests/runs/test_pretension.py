"""Bolts that are tightened: stiffness ratio of bolt and sleeve, lock, ranks, restart, refusals."""

import shutil

import numpy as np
import pytest

from pcontact.io.checkpoint import NAME
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
    Pretension,
    Scene,
)
from pcontact.simulation import Simulation
from tests.support.bad_input import mesh_text
from tests.support.restarts import Keep, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel
E, LENGTH, WIDTH = 100.0, 4.0, 3.0
# stiffness of the bolt, 1 wide, and of the sleeve
BOLT, SLEEVE = E / LENGTH, WIDTH * E / LENGTH
GROUPS = {(2, 1): "bolt", (2, 2): "sleeve", (1, 3): "bottom", (1, 4): "top", (1, 5): "cut", (1, 6): "bolt_side",
          (1, 7): "sleeve_side", (1, 8): "bolt_top", (1, 9): "sleeve_top"}  # fmt: skip


@pytest.fixture(params=["upright"])
def mesh(shared_tmp, request):
    """A bolt of 2 x 4 cells beside a sleeve of 2 x 3, with nodes of their own; mirrored, the floor is above."""
    path, up = shared_tmp / "bolt.msh", -1 if request.param == "mirrored" else 1
    if WORLD.rank == 0:
        nodes, cells, facets = [], [], []
        for group, start, width, rows in ((1, 0.0, 1.0, 4), (2, 1.0, WIDTH, 3)):
            first = len(nodes) + 1
            nodes += [(start + 0.5 * i * width, up * LENGTH * j / rows) for j in range(rows + 1) for i in range(3)]

            def at(i, j, first=first):
                return first + 3 * j + i

            cells += [(3, group, (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1))[::up])
                      for j in range(rows) for i in range(2)]  # fmt: skip
            facets += [(1, 3, (at(i, 0), at(i + 1, 0))) for i in range(2)]
            facets += [(1, top, (at(i, rows), at(i + 1, rows))) for i in range(2) for top in (4, 7 + group)]
            side = 2 if group == 1 else 0
            facets += [(1, 5 + group, (at(side, j), at(side, j + 1))) for j in range(rows)]
            facets += [(1, 5, (at(i, 2), at(i + 1, 2))) for i in range(2)] if group == 1 else []
        path.write_text(mesh_text(nodes, cells + facets, GROUPS))
    WORLD.Barrier()
    return path


def joint(path, pretension, phases=(), loads=(), order=1, **more):
    """Bolt and sleeve between a floor and a rigid plate that moves up and down."""
    plate = Coupling("top", displacement=[0.0, "free"], rotation=0.0)
    return Scene(
        MeshSpec(path, order=order), {"m": Material(E, 0.0)}, [Body("bolt", "m"), Body("sleeve", "m")],
        displacements=[Displacement("bottom", [0, 0])], couplings=[plate], pretensions=[pretension],
        phases=list(phases), loads=list(loads), petsc={"snes_rtol": "1e-12", "ksp_rtol": "1e-13"},
        output=Output(fields=False, checkpoint=True), **more,
    )  # fmt: skip


def simulated(case, comm=SELF):
    simulation = Simulation(case, comm)
    assert simulation.run(keep=True)
    simulation.close()
    return simulation.records.data()["steps"]


PHASES = [Phase("tighten", 1.0, 2), Phase("operate", 1.0, 2)]


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("kind", ["force", "shortening"])
def test_bolt_and_sleeve(mesh, order, kind):
    """Tightened, both take F = s / (1/kb + 1/ks); of a load on the plate the locked bolt takes kb / (kb + ks)."""
    force, load = 5.0, 3.0
    shortening = force * (1.0 / BOLT + 1.0 / SLEEVE)
    value = {"force": force} if kind == "force" else {"shortening": shortening}
    steps = simulated(joint(mesh, Pretension("cut", phases=["tighten"], **value), PHASES, [
        Load("top", force=[0.0, load], phases=["operate"])], order))  # fmt: skip
    found = [(step["pretensions"]["cut"]["force"], step["pretensions"]["cut"]["shortening"]) for step in steps]
    share = load * BOLT / (BOLT + SLEEVE)
    wanted = [(0.5 * force, 0.5 * shortening), (force, shortening), (force + 0.5 * share, shortening),
              (force + share, shortening)]  # fmt: skip
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    assert steps[1]["couplings"]["top"]["displacement"][1] == pytest.approx(-force / SLEEVE, rel=1e-9)
    assert max(step["imbalance"] for step in steps) < 1e-9


@pytest.mark.parametrize("mesh, up", [("upright", 1.0), ("mirrored", -1.0)], indirect=["mesh"])
def test_tension_while_a_load_ends(mesh, up):
    """A load on the side of the bolt, on nodes of the section too, ends; the bolt is locked, then drawn anew.

    The tension goes evenly from what it was to what it will be, whichever side of the section is up.
    """
    case = joint(mesh, Pretension("cut", force=5.0, phases=["tighten", "anew"]), [*PHASES, Phase("anew", 1.0, 2)],
                 [Load("bolt_side", traction=[0.5, -2.0 * up], phases=["tighten", "anew"])])  # fmt: skip
    case.contacts = [Contact("bolt_side", "sleeve_side", tied=True, formulation="penalty", name="hole")]
    steps = simulated(case)
    tensions = [step["pretensions"]["cut"]["force"] for step in steps]
    ends = np.array([0.0, *tensions[1::2]])
    np.testing.assert_allclose(tensions[::2], 0.5 * (ends[1:] + ends[:-1]), rtol=1e-8)
    assert abs(ends[2] - ends[1]) > 0.01 * ends[1] and max(step["imbalance"] for step in steps) < 1e-9
    assert ends[[1, 3]] == pytest.approx(5.0, rel=1e-9)


@parallel(1, 2)
def test_a_half_that_contact_alone_holds(mesh):
    """A force drives the upper half of a bolt off the lower one, over a gap, against a rock: it bears that force, and
    the halves are as far apart all along the section."""
    force, gap = 5.0, 0.3
    case = joint(mesh, Pretension("cut", force=-force))
    case.couplings = []
    case.contacts = [Contact("bolt_top", obstacle=Obstacle("plane", [0.0, LENGTH + gap], [0.0, -1.0]), name="rock",
                             friction=0.3)]  # fmt: skip
    simulation = Simulation(case, WORLD)
    solved, problem = simulation.run(keep=True), simulation.problem
    here, there = simulation.stepper.u, simulation.stepper.u.copy()
    problem.conditions.enter(there, problem.time)
    here.axpy(-1.0, there)
    apart = here.norm(3)
    simulation.close()
    step = simulation.records.data()["steps"][-1]
    assert solved and apart < 1e-12 * gap, "what follows has been left behind"
    assert step["contacts"]["rock"]["force"][1] == pytest.approx(force, rel=1e-9)
    assert -step["pretensions"]["cut"]["shortening"] == pytest.approx(gap + force / E * LENGTH, rel=1e-6)


def loaded():
    """Tightened by a force, then locked and loaded."""
    return Pretension("cut", force=5.0, phases=["tighten"]), PHASES, [Load("top", force=[0, 3.0], phases=["operate"])]


@parallel(1, 2, 3)
def test_ranks_and_restarts_do_not_matter(mesh, shared_tmp):
    """The same tension and shortening in every step, whole and from the end of the first phase on."""
    alone = simulated(joint(mesh, *loaded()))
    whole, cut = shared_tmp / f"whole{WORLD.size}", shared_tmp / f"cut{WORLD.size}"
    steps = run(joint(mesh, *loaded()), WORLD, whole, [KeepSecond(whole, cut, WORLD)])
    rest = run(joint(mesh, *loaded()), WORLD, shared_tmp / f"rest{WORLD.size}", restart=cut)
    for one, other in zip([*alone, *alone[2:]], [*steps, *rest], strict=True):
        for key in ("force", "shortening"):
            assert other["pretensions"]["cut"][key] == pytest.approx(one["pretensions"]["cut"][key], rel=1e-9)
        np.testing.assert_allclose(other["couplings"]["top"]["displacement"], one["couplings"]["top"]["displacement"],
                                   atol=1e-12)  # fmt: skip


class KeepSecond(Keep):
    """Copies the checkpoint of the second step, the last one of the first phase, aside."""

    def step(self, step, u, record):
        if step.number == 2 and self.comm.rank == 0:
            self.target.mkdir(parents=True, exist_ok=True)
            shutil.copy(self.source / NAME, self.target / NAME)


def test_a_bolt_with_contact_and_yielding(mesh):
    """Beside a sleeve with friction, of a material that yields at half the tension: the bolt flows and keeps it."""
    case = joint(mesh, Pretension("cut", force=60.0, phases=["tighten"]), [Phase("tighten", 1.0, 6), Phase("operate")])
    case.materials["soft"] = Material(E, 0.3, yield_stress=30.0, hardening=10.0)
    case.bodies[0].material = "soft"
    case.contacts = [Contact("bolt_side", "sleeve_side", friction=0.2, name="hole")]
    steps = simulated(case)
    last = steps[-2:]
    assert [step["pretensions"]["cut"]["force"] for step in last] == pytest.approx([60.0, 60.0], rel=1e-6)
    assert last[1]["pretensions"]["cut"]["shortening"] == pytest.approx(last[0]["pretensions"]["cut"]["shortening"])
    assert last[0]["plastic"]["max_equivalent_strain"] > 0.5 and last[0]["imbalance"] < 1e-6


def test_symmetric_half(mesh):
    """Nodes on a plane of symmetry are held on both sides of the section; its normal lies in the plane."""
    case = joint(mesh, Pretension("cut", force=5.0))
    case.displacements.append(Displacement("bolt_side", [0, "free"]))
    case.couplings, case.displacements[0] = [], Displacement("bottom", ["free", 0])
    case.displacements += [Displacement("sleeve_side", [0, "free"]), Displacement("bolt_top", ["free", 0])]
    (step,) = simulated(case)
    assert step["pretensions"]["cut"]["force"] == pytest.approx(5.0, rel=1e-9)
    assert step["pretensions"]["cut"]["shortening"] == pytest.approx(5.0 / BOLT, rel=1e-9)
    assert step["reactions"]["bolt_top"][1] == pytest.approx(5.0, rel=1e-9)


def test_refusals(mesh):
    for change, words in (
        ({"region": "bottom"}, "facets of their plane across|plane across a body"),
        ({"shortening": 1.0}, "both force and shortening"),
        ({"force": None}, "neither force nor shortening"),
        ({"region": "cot"}, "nearest is 'cut'"),
    ):
        with pytest.raises(InputError, match=words):
            Simulation(joint(mesh, Pretension(**{"region": "cut", "force": 1.0} | change)), SELF)
    case = joint(mesh, Pretension("cut", force=1.0))
    case.mesh.geometry = "joint.geo"
    with pytest.raises(InputError, match=r"mesh.geometry: found 'joint.geo' together with pretensions\[0\]"):
        Simulation(case, SELF)
    case.mesh.geometry, case.couplings = None, []
    case.displacements.append(Displacement("bolt_side", ["free", 0]))
    with pytest.raises(InputError, match="along its normal"):
        Simulation(case, SELF)
