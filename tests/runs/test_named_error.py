"""An error is named and reached: the loop, its report, its budget; from the command line and from Python."""

import json
import re
from dataclasses import replace
from functools import partial
from importlib.util import find_spec

import numpy as np
import pytest

import pcontact as pc
from drivers._common import make_mesh
from drivers.cases import rings
from drivers.error_norms import bulk_error
from drivers.studies._named_scenes import HELD_BACK, SCENES
from meshes import geometries
from meshes import rings as rings_mesh
from meshes.blocks import two_blocks
from meshes.punch import punch
from pcontact.adapt.errors import Measures
from pcontact.adapt.loop import FAILED, REACHED, SPENT, Loop
from pcontact.cli import check_scene, reach
from pcontact.io.result import load_result
from pcontact.material.elastic import lame
from pcontact.runtime.errors import InputError
from pcontact.runtime.options import Options
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI, PETSc, own_options
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene, Steps
from pcontact.scene.reader import read_scene
from pcontact.scene.target import Budget, Target
from pcontact.simulation import Simulation
from pcontact.solve.preconditioners import Reuse
from tests.support.commands import execute
from tests.support.wedges import cut_mesh

COMM = MPI.COMM_WORLD


def true_error(simulation, converged):
    """Of the rings, relative."""
    exact = partial(rings.exact, constants=rings.ring_constants())
    found = bulk_error(simulation.problem.space, [lame(rings.E, rings.NU)] * 2, simulation.stepper.u, exact)
    return found.energy / found.energy_of_exact, simulation.mesh.n_cells_total


def rings_scene(folder, error, degree=1):
    path = folder / "rings.msh"
    on_root(COMM, partial(rings_mesh, path, n=4, cell="triangle", order=2))
    scene = rings.ring_scene(path, degree, 0.0, gamma0=None)
    scene.accuracy = Target(error)
    return scene


@pytest.mark.parallel
@pytest.mark.slow
def test_rings_reach_their_error(shared_tmp):
    """The true error is below the one that is named, and the mesh is not much finer than that needs."""
    loop = Loop(rings_scene(shared_tmp, 0.04), take=true_error)
    outcome = loop.run(shared_tmp / "out")
    assert outcome.status == REACHED
    named, (true, cells) = loop.passes[-1].error, outcome.kept
    assert true < named <= 0.04 and true > 0.4 * 0.04
    report = json.loads((shared_tmp / "out" / "report.json").read_text())
    section = report["accuracy"]
    assert section["reached"] and section["error"] == pytest.approx(named) and section["target"]["of"] == "energy"
    assert len(section["passes"]) == len(loop.passes)
    assert section["half"]["unknowns"] > section["passes"][-1]["unknowns"]
    assert sum(section["parts"].values()) == pytest.approx(named)
    assert section["passes"][0]["cells"] < section["passes"][-1]["cells"] == report["cells"] == cells
    if COMM.rank == 0:
        assert not list((shared_tmp / "out").glob("pass_*"))
    COMM.barrier()


def shrink_fit(folder, geometry=None):
    """Rings of four straight cells in a quarter, whose arcs are deeper than the interference."""
    path, delta = folder / "fit.msh", 6e-4
    on_root(COMM, partial(rings_mesh, path, n=4, cell="triangle", delta=delta))
    scene = rings.ring_scene(path, 1, 0.0, pressure=0.0)
    scene.mesh.order = None
    if geometry is not None:
        on_root(COMM, (folder / geometry).write_text, geometries.rings(delta=delta))
        scene.mesh.geometry = folder / geometry
    return scene, partial(rings.measure, pressure=0.0, delta=delta)


def test_straight_facets_stay_without_the_geometry(tmp_path):
    """Their part is measured with degree 2, on the mesh of the file; no finer mesh takes it away."""
    scene, _ = shrink_fit(tmp_path)
    scene.accuracy = Target(0.1)
    loop = Loop(scene)
    assert loop.run().status == SPENT and len(loop.passes) == 1
    assert loop.passes[0].parts["straight_facets"] > 0.5


def test_facets_come_onto_the_geometry(tmp_path):
    """The straight cells become curved, and the part of the error that facets have falls; the true one is less."""
    scene, measure = shrink_fit(tmp_path, "fit.geo")
    scene.accuracy = Target(0.1)
    loop = Loop(scene, take=lambda simulation, converged: measure(simulation)["energy"])
    outcome = loop.run()
    first, last = loop.passes[0], loop.passes[-1]
    assert outcome.status == REACHED and outcome.kept < last.error <= 0.1
    assert "straight_facets" not in first.parts and last.degree == 2
    facets = [one.parts.get("curved_facets") for one in loop.passes]
    assert facets[-1] < 0.2 * max(facets)


def test_a_mesh_of_fewer_cells_is_no_budget_that_is_spent(tmp_path):
    """The last mesh of a disk on a block just misses its error, and has cells that are finer than needed."""
    scene = HELD_BACK["disk"].scene(tmp_path)
    scene.accuracy = Target(0.05)
    assert Loop(scene).run().status == REACHED


def test_a_load_step_that_takes_no_iteration(tmp_path):
    """Before it touches, a block moves as on the last mesh; the estimate asks for a tangent all the same."""
    two_blocks(tmp_path / "gap.msh", 2, 1, 2, "triangle", gap=0.1)
    scene = Scene(
        mesh=MeshSpec(tmp_path / "gap.msh", order=2), materials={"soft": Material(10.0, 0.3)},
        bodies=[Body("lower", "soft"), Body("upper", "soft")],
        contacts=[Contact("upper_bottom", "lower_top", name="face")],
        displacements=[Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_top", [0.0, -0.15])],
        steps=Steps(count=3), output=Output(fields=False), accuracy=Target(0.1),
    )  # fmt: skip
    loop = Loop(scene, take=lambda simulation, _: [step["newton"] for step in simulation.records.data()["steps"]])
    outcome = loop.run()
    assert outcome.status == REACHED and len(loop.passes) > 1 and outcome.kept[0] == 0


def test_a_quantity_that_is_zero(tmp_path):
    """Without lateral contraction a side has no reaction: its error is not one of rounding over rounding."""
    two_blocks(tmp_path / "blocks.msh", 2, 3, 4, "triangle")
    scene = Scene(
        mesh=MeshSpec(tmp_path / "blocks.msh", order=2), materials={"soft": Material(10.0, 0.0)},
        bodies=[Body("lower", "soft"), Body("upper", "soft")],
        contacts=[Contact("upper_bottom", "lower_top", name="face")],
        displacements=[Displacement("lower_bottom", ["free", 0.0]), Displacement("upper_top", ["free", -0.05]),
                       Displacement("left", [0.0, "free"])],
        output=Output(fields=False), accuracy=Target(0.02, "support:left"),
    )  # fmt: skip
    loop = Loop(scene)
    # there is no error in the energy norm, and no second mesh
    assert loop.run().status == REACHED and len(loop.passes) == 1 and all(one.error < 1e-5 for one in loop.passes)
    assert all(abs(one.quantity["value"]) < 1e-12 for one in loop.passes)


def test_a_force_where_nothing_touches(tmp_path):
    """No error is known of it: a finer mesh might touch."""
    two_blocks(tmp_path / "blocks.msh", 2, 3, 4, "triangle")
    scene = Scene(
        mesh=MeshSpec(tmp_path / "blocks.msh", order=2), materials={"soft": Material(10.0, 0.3)},
        bodies=[Body("lower", "soft"), Body("upper", "soft")],
        contacts=[Contact("upper_bottom", "lower_top", name="face")],
        displacements=[Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_top", [0.0, 0.2])],
        loads=[Load("left", pressure=0.1)], output=Output(fields=False), accuracy=Target(0.05, "force:face"),
    )  # fmt: skip
    loop = Loop(scene)
    assert loop.run().status == SPENT and all(one.error >= 1.0 for one in loop.passes)
    assert loop.passes[-1].quantity["value"] == 0.0


def punch_scene(folder, cell="triangle", **target):
    path = folder / f"punch_{cell}.msh"
    on_root(COMM, partial(punch, path, h=0.5, cell=cell))
    return Scene(
        mesh=MeshSpec(path), materials={"hard": Material(100.0, 0.3), "soft": Material(1.0, 0.3)},
        bodies=[Body("punch", "hard"), Body("block", "soft")],
        contacts=[Contact("block_under", "punch_face", name="face")],
        displacements=[Displacement("symmetry", [0.0, "free"]), Displacement("block_bottom", ["free", 0.0]),
                       Displacement("punch_top", ["free", -0.02])],
        output=Output(fields=True), accuracy=Target(**target),
    )  # fmt: skip


def test_a_budget_that_is_spent(shared_tmp, recwarn):
    """The best answer is kept, and what the target would have cost is told; the options of passes are no mistakes."""
    drawn = find_spec("pyvista") is not None
    scene = punch_scene(shared_tmp, error=0.01, budget=Budget(unknowns=600), pictures=drawn)
    run = pc.run(scene, output=shared_tmp / "out")
    assert not [str(one.message) for one in recwarn if "was not used" in str(one.message)]
    pictures = {path.name for path in shared_tmp.glob("out/*.png")}
    assert pictures == ({"errors.png", "error_mesh.png"} if drawn else set())
    section = run.report["accuracy"]
    assert not section["reached"] and section["error"] > 0.01 and run.converged
    assert all(one["unknowns"] <= 600 for one in section["passes"])
    assert section["target_cost"]["unknowns"] > 600
    result = load_result(shared_tmp / "out")
    assert np.concatenate(result.bodies.cell_data["error_estimate"]).shape == (run.report["cells"],)


@pytest.mark.parametrize("details", [False, True])
def test_the_least_error_that_a_budget_allows(tmp_path, details):
    """The last mesh fills it, and the last line says what has been found; one line a pass, unless all are asked for."""
    punch(tmp_path / "punch.msh", h=0.5)
    (tmp_path / "scene.toml").write_text(SCENE)
    words = ["-error", "best", "-error_of", "force:face.y", "-error_unknowns", "2000", "-error_details", str(details)]
    run = execute(tmp_path, ["run", "scene.toml", *words, "-o", "out"])
    assert run.returncode == REACHED
    section = json.loads((tmp_path / "out" / "report.json").read_text())["accuracy"]
    last, count = section["passes"][-1], len(section["passes"])
    assert section["reached"] and section["target"] == {"error": "best", "of": "force:face.y"}
    assert 1400 < last["unknowns"] <= 2000 and section["error"] == min(one["error"] for one in section["passes"]) < 5e-3
    lines = run.stdout.splitlines()
    assert sum(line.startswith("pass ") for line in lines) == count
    assert sum(line.startswith("step ") for line in lines) == (count if details else 1)
    (end,) = (line for line in lines if line.startswith("force:face.y = "))
    found = r"force:face.y = 0.009\d+ \+- [\de.-]+ \(.* %\), \d passes, .* s; half the error would take .* s; (.*)"
    assert re.fullmatch(found, end)[1] == "the budget is spent (unknowns)"


@pytest.mark.parallel
@pytest.mark.parametrize("order", [1, None])
def test_the_mesh_stays(shared_tmp, order):
    """With the scene, both of which an ordinary run takes: in the end it is where the loop has ended. A checkpoint
    goes on there, other loads too."""
    scene = punch_scene(shared_tmp, error=0.15)
    scene.mesh.order, scene.output, scene.steps = order, Output(fields=False, checkpoint=True), Steps(1.0, 2)
    scene.displacements[2].amplitude = [(0.0, 0.0), (1.0, 1.0), (2.0, 1.5)]
    outcome = Loop(scene, take=lambda run, _: run.problem.contacts[0].summary(run.stepper.u)).run(shared_tmp / "out")
    force = outcome.kept["force"][1]

    def again(one, **options):
        COMM.barrier()
        with own_options():
            Options().give(options)
            simulation = Simulation(one)
            try:
                assert simulation.run()
                summary = simulation.problem.contacts[0].summary(simulation.stepper.u)
                return simulation.problem.space.n_dofs, summary["force"][1], simulation.stepper.number
            finally:
                simulation.free()

    kept = read_scene(shared_tmp / "out" / "adapted.toml")
    assert kept.steps.count == 2 and kept.accuracy is None and kept.output.checkpoint
    unknowns, found, _ = again(kept)
    assert found == pytest.approx(force, rel=1e-3)
    scene.accuracy, scene.output.checkpoint = None, None
    size, found, _ = again(scene, mesh=str(shared_tmp / "out" / "adapted.h5"), mesh_order=kept.mesh.order)
    assert size == unknowns and found == pytest.approx(force, rel=1e-2)
    kept.steps = Steps(2.0, 4)
    _, found, number = again(kept, restart=str(shared_tmp / "out"))
    assert found > 1.4 * force and number == 4


@pytest.mark.parallel
def test_sources_stay_from_mesh_to_mesh(shared_tmp):
    """Of two surfaces the first mesh says which one is the source: a force does not change its sign between passes."""
    on_root(COMM, partial(two_blocks, shared_tmp / "pair.msh", 2, 4, 2, "triangle"))
    metal = {"metal": Material(1.0, 0.3)}
    scene = Scene(MeshSpec(shared_tmp / "pair.msh"), metal, [Body("lower", "metal"), Body("upper", "metal")],
                  contacts=[Contact(surfaces=["lower_top", "upper_bottom"], name="face")],
                  displacements=[Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_top", [0.0, -0.02])],
                  accuracy=Target(0.01, "force:face.y"))  # fmt: skip
    loop = Loop(scene, take=lambda simulation, _: simulation.problem.contacts[0].contact.source)
    source = loop.run().kept
    contact = loop.best_scene().contacts[0]
    assert contact.surfaces is None and contact.source == source and scene.contacts[0].surfaces is not None
    assert len({np.sign(one.quantity["value"]) for one in loop.passes}) == 1


@pytest.mark.parallel
def test_several_errors_at_once(shared_tmp):
    """Each is what it is alone on the same mesh; the last mesh has all of them below the target."""
    each = ("energy", "force:face.y", "support:block_bottom")
    loop = Loop(punch_scene(shared_tmp, error=0.04, of=",".join(each)))
    assert loop.run(shared_tmp / "out").status == REACHED
    section = json.loads((shared_tmp / "out" / "report.json").read_text())["accuracy"]
    assert tuple(section["each"]) == each and section["target"]["of"] == ",".join(each)
    assert section["error"] == max(one["error"] for one in section["each"].values()) <= 0.04
    assert len(loop.passes) > 1 and all(len(one.each) == 3 for one in loop.passes)
    for number, of in enumerate(each):
        alone = Loop(punch_scene(shared_tmp, error=0.04, of=of))
        alone.run()
        first, one = alone.passes[0], loop.passes[0].each[number]
        assert one.of == of and one.parts["mesh"] == pytest.approx(first.parts["mesh"], rel=1e-3)
        # what one of them needs is a part of what all need
        assert alone.passes[-1].unknowns < 1.5 * loop.passes[-1].unknowns


@pytest.mark.parallel
def test_the_best_answer_need_not_be_the_last(shared_tmp, monkeypatch):
    """Where a finer mesh names a larger error, the results of the mesh before are given, with all passes."""
    call, passes = Measures.__call__, []

    def worse(self, *args):
        done = call(self, *args)
        done.error *= 1.0 + 9.0 * len(passes)
        passes.append(done)
        return done

    monkeypatch.setattr(Measures, "__call__", worse)
    scene = punch_scene(shared_tmp, error=0.01, budget=Budget(unknowns=600))
    run = pc.run(scene, output=shared_tmp / "out")
    report = json.loads((shared_tmp / "out" / "report.json").read_text())
    section = report["accuracy"]
    assert section["best"] == 1 < len(section["passes"]) and not section["reached"]
    assert section["error"] == section["passes"][0]["error"] < section["passes"][1]["error"]
    assert report["dofs"] == section["passes"][0]["unknowns"] == run.report["dofs"]
    assert run.report["accuracy"] == section and not list((shared_tmp / "out").glob("pass_*"))


def test_what_programs_read_of_a_budget_that_is_spent(tmp_path, capsys):
    """A line for every load step and pass, one for the end of all, and the exit status."""
    scene = punch_scene(tmp_path, error=0.01, budget=Budget(unknowns=100))
    assert reach(scene, tmp_path / "out", True) == SPENT
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines() if line.startswith("{")]
    assert [line["event"] for line in lines] == ["step", "pass", "end"]
    assert lines[1]["error"] > 0.01 and lines[2]["converged"] and not lines[2]["reached"]


@pytest.mark.parallel
def test_quadrilaterals_are_halved(shared_tmp):
    """All of them, as often as it takes; cells that nothing cuts are refused."""
    path = make_mesh(two_blocks, shared_tmp / "blocks.msh", 2, 2, 3, "quadrilateral")
    scene = Scene(
        mesh=MeshSpec(path, 1), materials={"m": Material(10.0, 0.3)}, bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", name="face")],
        displacements=[Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_top", [0.0, -0.05])],
        output=Output(fields=False), accuracy=Target(0.1),
    )  # fmt: skip
    loop = Loop(scene)
    assert loop.run().status == REACHED
    assert [one.cells for one in loop.passes] == [13 * 4**k for k in range(len(loop.passes))] and len(loop.passes) > 1


@pytest.mark.parallel
@pytest.mark.parametrize("kinds, error", [("punch", 0.08), (("wedge", "hexahedron", "pyramid"), 0.2)])
def test_other_cells_are_divided(shared_tmp, kinds, error):
    """Quadrilaterals where an error is large in one place; wedges and pyramids, which nothing halves, before all."""
    if kinds == "punch":
        scene = punch_scene(shared_tmp, cell="quadrilateral", error=error)
        scene.mesh.order = 1
    else:
        path = make_mesh(two_blocks, shared_tmp / "a.msh", 3, 2, 1, "hexahedron")
        on_root(COMM, partial(cut_mesh, path, shared_tmp / "mixed.msh", kinds))
        scene = Scene(
            mesh=MeshSpec(shared_tmp / "mixed.msh", 1), materials={"m": Material(10.0, 0.3)},
            bodies=[Body("lower", "m"), Body("upper", "m")], accuracy=Target(error),
            contacts=[Contact("upper_bottom", "lower_top", name="face")],
            displacements=[Displacement("lower_bottom", [0.0] * 3), Displacement("upper_top", [0.0, 0.0, -0.05])],
        )  # fmt: skip
    loop = Loop(scene)
    assert loop.run(shared_tmp / "out").status == REACHED and len(loop.passes) > 1
    report = json.loads((shared_tmp / "out" / "report.json").read_text())
    section, name = report["accuracy"], "triangles" if kinds == "punch" else "tetrahedra"
    assert section["cells"]["chosen"] == name and section["error"] <= error
    assert {block.cell for block in loop.mesh.blocks} == {"triangle" if kinds == "punch" else "tetrahedron"}
    if COMM.rank == 0:
        assert load_result(shared_tmp / "out").bodies.cells[0][0] == ("triangle" if kinds == "punch" else "tetra")


def test_nearly_incompressible_quadrilaterals(tmp_path):
    """Their displacement has degree 2 where nobody says; with degree 1 triangles would lock, so all are halved."""
    scene = punch_scene(tmp_path, cell="quadrilateral", error=0.06)
    scene.materials["soft"] = Material(1.0, 0.495)
    loop = Loop(scene)
    assert loop.run(tmp_path / "out").status == REACHED
    section = json.loads((tmp_path / "out" / "report.json").read_text())["accuracy"]
    assert {one.degree for one in loop.passes} == {2} == {section["degree"]["degree"]}
    assert "block (locking)" in section["degree"]["why"] and section["cells"]["chosen"] == "triangles"
    scene.mesh.order, scene.accuracy = 1, Target(0.12, budget=Budget(unknowns=1000))
    loop = Loop(scene)
    loop.run()
    assert len(loop.passes) > 1
    assert all(one.cells == 4**k * loop.passes[0].cells for k, one in enumerate(loop.passes))


SCENE = """
mesh = { file = "punch.msh" }
materials = { hard = { E = 100.0, nu = 0.3 }, soft = { E = 1.0, nu = 0.3 } }
bodies = [{ region = "punch", material = "hard" }, { region = "block", material = "soft" }]
contacts = [{ source = "block_under", target = "punch_face", name = "face" }]
displacements = [
    { region = "symmetry", value = [0.0, "free"] }, { region = "block_bottom", value = ["free", 0.0] },
    { region = "punch_top", value = ["free", -0.02] },
]
"""
FORECAST = r"error of 4 % of energy: about (\d+) passes of degree 2 with (.+) unknowns, ([\d.e+-]+) s, ([\d.e+-]+) MB"


def test_a_check_leaves_no_options(tmp_path):
    """What it has chosen is no user's choice for the forecast that follows."""
    before = dict(PETSc.Options().getAll())
    check_scene(punch_scene(tmp_path, error=0.01))
    assert dict(PETSc.Options().getAll()) == before


def test_a_forecast_and_the_run(tmp_path):
    """What `pcontact check -error` says: passes to two, unknowns to a factor of 3; seconds are those of the machine."""
    punch(tmp_path / "punch.msh", h=0.5)
    (tmp_path / "scene.toml").write_text(SCENE)
    checked = execute(tmp_path, ["check", "scene.toml", "-error", "4%"])
    found = re.search(FORECAST, checked.stdout)
    assert checked.returncode == 0 and found is not None, checked.stdout
    assert "neither pcontact nor PETSc" not in checked.stdout
    assert execute(tmp_path, ["run", "scene.toml", "-error", "4%", "-o", "out"]).returncode == 0
    passes = json.loads((tmp_path / "out" / "report.json").read_text())["accuracy"]["passes"]
    unknowns = [float(word) for word in found[2].split(",")]
    assert abs(int(found[1]) - len(passes)) <= 2 and len(unknowns) == int(found[1])
    assert 1 / 3 < unknowns[-1] / passes[-1]["unknowns"] < 3.0
    assert float(found[3]) > 0.0


@pytest.mark.parallel
def test_a_pressure_whose_square_has_no_integral(shared_tmp):
    """Under the corner of a punch a hundred times as stiff as the block: the run ends soon and says so; of one as
    soft as the block, whose pressure goes like r^-0.23, the error falls as cells become smaller there."""
    scene = SCENES["punch"].scene(shared_tmp)
    scene.accuracy = Target(0.1, "pressure:face")
    loop = Loop(scene)
    assert loop.run().status == SPENT and len(loop.passes) <= 4
    assert re.fullmatch(r"not reached: .*no memory; toward corners .*: name the error of a force", loop._decision.why)
    scene = SCENES["soft_punch"].scene(shared_tmp)
    scene.accuracy = Target(0.04, "pressure:face")
    loop = Loop(scene)
    assert loop.run().status == REACHED and loop.passes[-1].unknowns < 20_000


@pytest.mark.parallel
@pytest.mark.parametrize("seed", range(3))
def test_a_smaller_target_ends_with_no_larger_error(shared_tmp, seed):
    """Punches drawn at random, with one budget: also where only the larger targets can be reached, whose load steps are
    the user's."""
    rng = np.random.default_rng(seed)
    scene = punch_scene(shared_tmp, cell=str(rng.choice(["triangle", "quadrilateral"])), error=0.1)
    scene.materials["hard"] = Material(10.0 ** rng.uniform(0.0, 3.0), rng.uniform(0.0, 0.4))
    scene.contacts[0].friction, scene.steps = float(rng.choice([0.0, 0.3])), Steps(count=3)
    scene.mesh.order, scene.output.fields = int(rng.integers(1, 3)), False
    budget, named = Budget(unknowns=float(rng.integers(1500, 4000))), []
    for error in (0.15, 0.05, 0.02, 0.005):
        loop = Loop(replace(scene, accuracy=Target(error, budget=budget)))
        status = loop.run().status
        best = loop.passes[loop.best - 1]
        assert status in (REACHED, SPENT) and all(one.unknowns <= budget.unknowns for one in loop.passes)
        assert (status == REACHED) == (best.error <= error) and best.steps >= 3
        named.append(best.error)
    assert all(finer <= 1.02 * coarser for coarser, finer in zip(named[:-1], named[1:], strict=True)), named


def test_a_pass_that_cannot_be_run(tmp_path, monkeypatch, capsys):
    """The best answer before it is kept."""
    scene, run = rings_scene(tmp_path, 0.02), Loop._run

    def failing(self, *args):
        if len(self.passes) == 2:
            raise InputError("PETSc options: a row has too many entries")
        return run(self, *args)

    monkeypatch.setattr(Loop, "_run", failing)
    assert reach(scene, tmp_path / "out", False) == FAILED
    assert "a row has too many entries" in capsys.readouterr().err
    accuracy = json.loads((tmp_path / "out" / "report.json").read_text())["accuracy"]
    assert len(accuracy["passes"]) == 2 and not accuracy["reached"]
    assert not list((tmp_path / "out").glob("pass_*"))


@pytest.mark.parallel
def test_a_preconditioner_serves_several_load_steps(shared_tmp, monkeypatch):
    """In runs that nothing restarts; what is found is the same."""
    scene, kept, keep = HELD_BACK["sheared"].scene(shared_tmp), [], Reuse.keep
    scene.petsc, scene.output.checkpoint = {"pc_direct_below": "0"}, True

    def told(self, *given):
        kept.append(keep(self, *given))
        return kept[-1]

    def found(directory=None):
        kept.clear()
        simulation = Simulation(scene)
        try:
            assert simulation.run(directory)
            problem, u = simulation.problem, simulation.stepper.u
            return kept.count(False), problem.forces.reactions(u, problem.unbalanced(u))["upper_top"]
        finally:
            simulation.free()

    monkeypatch.setattr(Reuse, "keep", told)
    (each, alone), (once, force) = found(shared_tmp / "restartable"), found()
    assert each == 4 and once == 1
    np.testing.assert_allclose(force, alone, rtol=1e-6)
