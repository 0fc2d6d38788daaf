"""Bodies that come and go with the phases of a run: shares of the load, layers in contact, ranks, restart, refusals."""

import numpy as np
import pytest

import pcontact as pc
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.simulation import Simulation
from tests.support.restarts import KeepAll, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel
EXACT = {"snes_rtol": "1e-12", "ksp_rtol": "1e-13"}


def grid(nx, ny, height, y=0.0):
    """Points and quadrilaterals of a rectangle of the width 2."""
    across, up = np.meshgrid(np.linspace(0, 2, nx + 1), np.linspace(y, y + height, ny + 1))
    first = (np.arange(ny)[:, None] * (nx + 1) + np.arange(nx)).ravel()
    return np.column_stack([across.ravel(), up.ravel()]), first[:, None] + [0, 1, nx + 2, nx + 1]


def stack(*heights, cap=None):
    """Layers that share nodes, from the bottom, numbered from the top; and a cap that has nodes of its own."""
    points, cells = grid(4, 2 * len(heights), 2.0 * len(heights))
    cells = cells[::-1]
    layer = (points[cells].mean(axis=1)[:, 1] // 2).astype(int)
    groups = {name: layer == k for k, name in enumerate(heights)}
    top = 2.0 * len(heights)
    facets = {"left": lambda x: x[:, 0] == 0, "right": lambda x: x[:, 0] == 2, "bottom": lambda x: x[:, 1] == 0}
    if cap is not None:
        more, above = grid(3, 2, 2.0, top)
        cells = np.concatenate([cells, above + len(points)])
        own = np.arange(len(cells)) >= len(cells) - len(above)
        groups = {name: np.append(rows, np.zeros(len(above), bool)) for name, rows in groups.items()} | {cap: own}
        facets[f"top_{cap}"] = lambda x: x[:, 1] == top + 2.0
        # both surfaces are in the same place: corners say whose facet it is
        low, first = np.flatnonzero(points[:, 1] == top), len(points) + np.arange(4)
        facets[f"top_{heights[-1]}"] = np.column_stack([low[:-1], low[1:]])
        facets[f"bottom_{cap}"] = np.column_stack([first[:-1], first[1:]])
        points = np.concatenate([points, more])
    return pc.mesh_from((points, {"quad": cells}), groups=groups, facets=facets)


def bars(phases, second, **more):
    """Two bars alongside, whose ends stay straight; the second one is there in some phases."""
    return pc.Scene(
        mesh=stack("one", "two"), materials={"m": {"E": 100.0, "nu": 0.0}, "n": {"E": 50.0, "nu": 0.0}},
        bodies=[pc.Body("one", "m"), pc.Body("two", "n", phases=second)], displacements={"left": [0, 0]},
        couplings=[pc.Coupling("right", displacement=["free", 0], rotation=0.0)], phases=phases, petsc=EXACT, **more,
    )  # fmt: skip


def test_a_bar_that_is_welded_on_bears_its_share_of_what_comes_then():
    """F on one bar; with the second one, 2 F: it has 1/3 of the second F. Without it again the first one has all; when
    it comes back it is new."""
    phases = [pc.Phase("alone"), pc.Phase("both", count=2), pc.Phase("without", count=2), pc.Phase("anew")]
    load = pc.Load("right", force=[10.0, 0.0], amplitude=[[0, 0], [1, 1], [2, 2], [3, 2], [4, 3]])
    found = {}

    def watch(step):
        fields = step.fields()
        found[step.time] = {body: fields.stress[fields.cell_data["body"] == body, 0] for body in (0, 1)}

    result = pc.run(bars(phases, ["both", "anew"], loads=[load]), comm=SELF, on_step=watch)
    expected = {1.0: (5.0, None), 1.5: (5 + 2.5 * 2 / 3, 2.5 / 3), 2.0: (5 + 5 * 2 / 3, 5 / 3), 2.5: (9 + 1 / 6, None),
                3.0: (10.0, None), 4.0: (10 + 5 * 2 / 3, 5 / 3)}  # fmt: skip
    for time, stresses in expected.items():
        for body, stress in enumerate(stresses):
            assert len(found[time][body]) == (0 if stress is None else 8), "cells of absent bodies are left out"
            np.testing.assert_allclose(found[time][body], stress or 0.0, rtol=1e-9)
    steps = result.steps
    assert [step["absent"] for step in steps] == [["two"], [], [], ["two"], ["two"], []]
    moved = [step["couplings"]["right"]["displacement"][0] for step in steps]
    expected = [0.1, 0.1 + 0.1 / 3, 0.1 + 0.2 / 3, 0.18 + 1 / 300, 0.2, 0.2 + 0.2 / 3]
    np.testing.assert_allclose(moved, expected, rtol=1e-9)
    assert max(step["imbalance"] for step in steps) < 1e-12
    # half of it is left in the middle of the phase in which it goes: of what its own 3/4 of the support has borne
    assert steps[3]["released"]["force"][0] == pytest.approx(-0.5 * 0.75 * 10 / 3, rel=1e-9)


def test_forces_of_a_coupling_do_not_depend_on_numbers():
    """A warm layer comes with a coupling on average: while its stress rises, forces are the same in all numberings."""
    points, cells = grid(3, 4, 4.0)
    found = []
    for order in (np.arange(12), np.random.default_rng(1).permutation(12)):
        own = cells[order]
        low = points[own].mean(axis=1)[:, 1] < 2.0
        mesh = pc.mesh_from((points, {"quad": own}), groups={"base": low, "layer": ~low},
                            facets={"bottom": lambda x: x[:, 1] == 0, "top": lambda x: x[:, 1] == 4})  # fmt: skip
        steps = pc.run(pc.Scene(
            mesh=mesh, materials={"m": {"E": 100.0, "nu": 0.3, "expansion": 1e-3}},
            bodies=[pc.Body("base", "m"), pc.Body("layer", "m", phases=["on"])], displacements={"bottom": [0, 0]},
            couplings=[pc.Coupling("top", displacement=[0.01, "free"], rotation=0.0, average=True)],
            temperatures=[pc.Temperature("1 + 2*x", "layer", reference=0.0)],
            phases=[pc.Phase("alone"), pc.Phase("on", count=4)], petsc=EXACT,
        ), comm=SELF).steps[1:]  # fmt: skip
        found.append([[*step["couplings"]["top"]["force"], step["couplings"]["top"]["moment"],
                       *step["released"]["force"]] for step in steps])  # fmt: skip
        assert max(step["imbalance"] for step in steps) < 1e-10
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)
    # all of it goes evenly from nothing to what it is at the end
    parts = np.arange(1, 5)[:, None] / 4.0
    np.testing.assert_allclose(np.array(found[0])[:, :3], parts * found[0][-1][:3], atol=1e-9)


# small against the stress of the stretch in the layer, 0.05
PRESSURE = 0.01


def layered(material, stretch, **contact):
    """A base that is stretched; a layer welded onto it then, and a cap that is pressed on the layer."""
    held = [pc.Displacement("bottom", ["free", 0]), pc.Displacement("left", [0, "free"]),
            pc.Displacement("right", [stretch, "free"], [[0, 0], [1, 1]])]  # fmt: skip
    return pc.Scene(
        mesh=stack("base", "layer", cap="cap"), materials={"m": {"E": 100.0, "nu": 0.0}, "n": material},
        bodies=[pc.Body("base", "m"), pc.Body("layer", "n", phases=["build", "press"]),
                pc.Body("cap", "n", phases=["build", "press"])],
        contacts=[pc.Contact("top_layer", "bottom_cap", name="joint", interference="adjust", adjust_within=0.1,
                             **contact)],
        displacements=held, loads=[pc.Load("top_cap", pressure=PRESSURE, phases=["press"])],
        phases=[pc.Phase("stretch"), pc.Phase("build"), pc.Phase("press", count=2)], petsc=EXACT,
    )  # fmt: skip


YIELDS = {"E": 50.0, "nu": 0.0, "yield_stress": 0.0105, "hardening": 5.0}


@pytest.mark.parametrize("material, contact", [
    ({"E": 50.0, "nu": 0.0}, {}), (YIELDS, {}), (YIELDS, {"theta": 1.0, "adjoint": "consistent"}),
    ({"E": [50.0] * 3, "nu": [0.0] * 3, "G": [10.0] * 3}, {}),
    ({"E": 50.0, "nu": 0.0}, {"friction": 0.4, "theta": -1.0}), ({"E": 50.0, "nu": 0.0}, {"formulation": "penalty"}),
])  # fmt: skip
def test_a_layer_on_a_stretched_base_has_no_stress_but_that_of_the_cap(material, contact):
    """The stretch of the base, beyond the yield stress of the layer, is none of the layer's: it bears the pressure, and
    so does the contact between two bodies that have begun."""
    result = pc.run(layered(material, 2e-3, **contact), comm=SELF)
    fields = result.fields()
    # the cap is shorter than the stretched layer by a thousandth
    for body, along in ((0, 0.1), (1, 0.0), (2, 0.0)):
        stress = fields.stress[fields.cell_data["body"] == body]
        np.testing.assert_allclose(stress[:, 0], along, atol=5e-3 * PRESSURE)
        np.testing.assert_allclose(stress[:, 1], -PRESSURE, atol=5e-3 * PRESSURE)
    np.testing.assert_allclose(result.contact["joint"].pressure, PRESSURE, atol=5e-3 * PRESSURE)
    assert not fields.cell_data.get("equivalent_plastic_strain", np.zeros(1)).any()
    # the layer goes along with the base, the cap is as it was in the mesh: their gap then is that of the mesh
    assert "joint" not in result.steps[0]["contacts"] and result.steps[1]["contacts"]["joint"]["max_pressure"] < 1e-9
    assert result.steps[-1]["probes"] == {}


def test_a_block_that_comes_to_a_stack_in_contact():
    """A base sinks by its weight; a block comes and is pressed on it. It rests on the base where that is, or, adjusted,
    sinks by what the base sinks from then on alone. (The stress of the cells of the base is that of their middle.)"""
    for said, gap in (({}, 0.02), ({"interference": "adjust", "adjust_within": 0.1}, 0.0)):
        scene = pc.Scene(
            mesh=stack("base", cap="block"), materials={"m": {"E": 100.0, "nu": 0.0}},
            bodies=[pc.Body("base", "m"), pc.Body("block", "m", phases=["on"])],
            contacts=[pc.Contact("bottom_block", "top_base", name="joint", traction="source", **said)],
            displacements={"bottom": [0, 0], "top_block": [0, "free"]},
            loads=[pc.Load("base", body_force=[0.0, -1.0], amplitude=[[0, 0], [1, 1]]),
                   pc.Load("top_block", pressure=2.0)],
            output={"probes": ["top_block"]}, phases=[pc.Phase("alone"), pc.Phase("on", count=2)], petsc=EXACT,
        )  # fmt: skip
        steps = pc.run(scene, comm=SELF).steps
        assert steps[0]["probes"] == {} and steps[0]["contacts"] == {} and "top_block" not in steps[0]["reactions"]
        np.testing.assert_allclose([step["reactions"]["bottom"][1] for step in steps], [4.0, 6.0, 8.0], rtol=1e-9)
        np.testing.assert_allclose([step["probes"]["top_block"]["mean"][1] for step in steps[1:]],
                                   [-gap - 0.04, -gap - 0.08], rtol=1e-8)  # fmt: skip


# -- ranks, restart ----------------------------------------------------------------------------------------------------


def bridge(**more):
    """Two walls; a bridge between them is laid between two phases, and then loaded. Its cells are the first."""
    points, cells = grid(8, 6, 2.0)
    middle = points[cells].mean(axis=1)
    deck = (np.abs(middle[:, 0] - 1.0) < 0.5) & (middle[:, 1] > 1.0)
    walls = np.abs(middle[:, 0] - 1.0) > 0.5
    cells, deck = np.concatenate([cells[deck], cells[walls]]), np.arange(deck.sum() + walls.sum()) < deck.sum()
    used = np.unique(cells)
    points, cells = points[used], np.searchsorted(used, cells)
    side = np.flatnonzero((points[:, 0] == 0.5) & (points[:, 1] > 0.999))
    mesh = pc.mesh_from(
        (points, {"quad": cells}), groups={"deck": deck, "walls": ~deck},
        facets={"ground": lambda x: x[:, 1] == 0, "side": np.column_stack([side[:-1], side[1:]]),
                "top": lambda x: x[:, 1] == 2},
    )  # fmt: skip
    return pc.Scene(
        mesh=mesh, materials={"m": {"E": 100.0, "nu": 0.3}},
        bodies=[pc.Body("walls", "m"), pc.Body("deck", "m", phases=["laid", "loaded"])],
        displacements={"ground": [0, 0]},
        loads=[pc.Load("side", pressure=1.0, phases=["walls"]), pc.Load("walls", body_force=[2.0, -1.0]),
               pc.Load("top", traction=[0.0, -1.0], phases=["loaded"])],
        phases=[pc.Phase("walls"), pc.Phase("laid"), pc.Phase("loaded", count=2), pc.Phase("gone", count=2)],
        petsc=EXACT, **more,
    )  # fmt: skip


def forces(steps):
    none = {"force": [0, 0]}
    return np.array([[*step["reactions"]["ground"], *step.get("released", none)["force"]] for step in steps])


@parallel(1, 2, 3)
def test_ranks_do_not_matter():
    """Forces, and fields of the last load step; facets of a group that were the absent body's are those of its
    neighbour, and what it joins are two bodies without it."""
    alone = pc.run(bridge(), comm=SELF)
    # 8 of the 12 units of area are walls; a pressure on the side of the left one, which the deck will have
    np.testing.assert_allclose(alone.steps[0]["reactions"]["ground"], [-2.0 * 2.0 + 1.0, 2.0], rtol=1e-9)
    result = pc.run(bridge(), comm=WORLD)
    np.testing.assert_allclose(forces(result.steps), forces(alone.steps), atol=1e-9)
    whole, fields = result.gather(everywhere=True), alone.fields()
    np.testing.assert_array_equal(np.sort(whole.cell_numbers), np.sort(fields.cell_numbers))
    one, other = (f.displacement[np.argsort(f.node_numbers)] for f in (whole, fields))
    np.testing.assert_allclose(one, other, atol=1e-9)
    # what has been there for a while has left the walls with nothing
    assert alone.steps[-1]["absent"] == ["deck"] and max(step["imbalance"] for step in result.steps) < 1e-10
    names = []

    class Look(Simulation):
        def _assemble(self):
            super()._assemble()
            mesh = self.problem.space.mesh
            names.append((mesh.n_components, mesh.component_names))

    simulation = Look(bridge(), WORLD)
    assert simulation.run()
    simulation.close()
    assert names == [(2, ["walls"] * 2), *[(1, ["walls + deck"])] * 2, (2, ["walls"] * 2)]


@parallel(1, 2)
def test_restart_in_all_phases(shared_tmp):
    """The numbers of the whole run, from a checkpoint of each load step."""
    folder, output = shared_tmp / "whole", pc.Output(fields=False, checkpoint=True)
    steps = run(bridge(output=output), WORLD, folder, [KeepAll(folder, shared_tmp, WORLD)])
    for stop in (1, 3, 4):
        rest = run(bridge(output=output), WORLD, shared_tmp / f"rest{stop}", restart=shared_tmp / str(stop))
        assert [step["absent"] for step in rest] == [step["absent"] for step in steps[stop:]]
        np.testing.assert_allclose(forces(rest), forces(steps[stop:]), atol=1e-9)


@pytest.mark.parametrize("dynamics", [False, True])
def test_what_a_body_stores_goes_with_it(dynamics):
    """It is in the balance as what has gone, at rest and in motion."""
    phases = [pc.Phase("both", count=4), pc.Phase("without", count=8)]
    load = pc.Load("right", force=[10.0, 0.0], amplitude=[[0, 0], [1, 1], [2, 1]])
    more = {"dynamics": {"integrator": "trapezoidal"}} if dynamics else {}
    scene = bars(phases, ["both"], loads=[load], output=pc.Output(energy=True, fields=False), **more)
    for material in scene.materials.values():
        material.density = 0.5
    history = pc.run(scene, comm=SELF).history
    gone = history["energy.gone"]
    assert np.all(gone[:4] == 0.0) and np.ptp(gone[4:]) < 1e-12 and gone[-1] > 0.0
    assert np.abs(history["energy.defect"]).max() < 1e-9
    if not dynamics:
        # half of the stiffness of the other bar: a third of what both have stored
        assert gone[-1] == pytest.approx(history["energy.stored"][3] / 3.0, rel=1e-9)


# -- refusals ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("change, message", [
    (lambda scene: setattr(scene.bodies[1], "strain", "finite"), r"bodies\[1\] \(deck\).phases: found .*finite strain"),
    (lambda scene: setattr(scene.bodies[1], "phases", []), r"bodies\[1\] \(deck\).phases: found no phase"),
    (lambda scene: setattr(scene.bodies[0], "phases", ["laid"]), r"phases\[0\] \(walls\).name: found 'walls', in"),
])  # fmt: skip
def test_what_is_refused(change, message):
    """What a body that begins cannot be, and phases without bodies."""
    scene = bridge()
    change(scene)
    with pytest.raises(InputError, match=message):
        pc.run(scene, comm=SELF)


def test_contacts_of_absent_bodies_are_refused():
    """Ties of the undeformed bodies, and what a phase says of a contact that is not there."""
    scene = layered({"E": 50.0, "nu": 0.0}, 0.1)
    scene.contacts[0] = pc.Contact("top_layer", "bottom_cap", name="joint", tied=True)
    with pytest.raises(InputError, match=r"joint\).tied: found true with body layer, which begins"):
        pc.run(scene, comm=SELF)
    scene = layered({"E": 50.0, "nu": 0.0}, 0.1)
    scene.phases[0].friction = {"joint": 0.2}
    with pytest.raises(InputError, match=r"phases\[0\] \(stretch\).friction: found 'joint', of which a body is absent"):
        pc.run(scene, comm=SELF)
