"""Where the bodies were, for the next mesh."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcontact.adapt.history import ROOM, Beginning, Known, Watch


def _begun(known, time=1.0):
    """A `Beginning` on a mesh of two nodes, of a run at a time; it has them in another order."""
    rows = np.array([1, 0])
    space = SimpleNamespace(mesh_nodes=rows, owned_local=slice(None), dim=2)
    u = SimpleNamespace(getArray=lambda readonly: np.full(4, 10.0))
    stepper = SimpleNamespace(schedule=SimpleNamespace(time=time), u=u)
    return Beginning(SimpleNamespace(problem=SimpleNamespace(space=space), stepper=stepper), known)


def _field(value):
    return np.array([[value, 0.0], [0.0, value]])


def test_bodies_move_on_as_on_the_last_mesh():
    begun = _begun(Known([1.0, 2.0], [_field(1.0), _field(3.0)]))
    assert begun(1.5) == pytest.approx(10.0 + np.array([[0.0, 1.0], [1.0, 0.0]]))
    assert begun(3.0) is None and begun.at(2.0) == pytest.approx(_field(3.0)[::-1])


def test_some_load_steps_tell_no_motion():
    """But where the bodies were at the end."""
    known = Known([1.0, 2.0], [_field(1.0), _field(3.0)], every=False)
    assert _begun(known)(2.0) is None and _begun(known).at(2.0) == pytest.approx(_field(3.0)[::-1])
    moved = known.moved(lambda fields: [2.0 * field for field in fields])
    assert moved.fields[1] == pytest.approx(_field(6.0))


def test_load_steps_that_need_no_beginning():
    """One iteration from the end of the one before was enough for each of those of the last mesh that they touch."""
    fields = [_field(1.0), _field(3.0), _field(4.0)]
    known = Known([1.0, 2.0, 3.0], fields, alone=[True, True, False])
    assert _begun(known, 0.0)(0.5) is None and _begun(known, 0.5)(1.5) is None and _begun(known, 0.0)(2.0) is None
    for begin, end in ((1.5, 2.5), (2.0, 2.5), (2.0, 3.0), (0.0, 3.0)):
        assert _begun(known, begin)(end) == pytest.approx(10.0 + _begun(known).at(end) - _begun(known).at(begin))
    assert not any(_begun(known._replace(alone=())).alone(0.0, end) for end in (0.5, 1.0, 3.5))


def _watch(problem, begin, scene):
    estimate = SimpleNamespace(squares=None, over_steps=0.0, last={"algebraic": 0.0, "energy_norm": 0.0})
    return Watch(SimpleNamespace(problem=problem, begin=begin, scene=scene, error_estimate=estimate))


def _step(number, newton):
    return SimpleNamespace(begin=float(number), time=number + 1.0, newton=newton, unbalanced=None)


def test_what_took_one_iteration():
    """From the end of the load step before, and not from what another mesh has said."""
    space = SimpleNamespace(comm=SimpleNamespace(size=1), n_dofs=4)
    problem, scene, taken = SimpleNamespace(space=space), SimpleNamespace(frictional=True), {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pcontact.adapt.history.at_nodes", lambda space, u: u)
        for begin in (None, SimpleNamespace(alone=lambda begin, end: begin < 1.0)):
            watch = _watch(problem, begin, scene)
            for number, newton in enumerate((1, 0, 1, 2)):
                watch.step(_step(number, newton), number, {})
            taken[begin is None] = watch.known.alone
    assert taken == {True: [True, True, True, False], False: [True, False, False, False]}


@pytest.mark.parametrize("unknowns, steps, kept", [(100, 60, 60), (ROOM // 192, 24, 24), (ROOM // 192, 25, 13)])
def test_load_steps_that_there_is_room_for(unknowns, steps, kept, monkeypatch):
    """All of them on small meshes; else every other one, and the last."""
    monkeypatch.setattr("pcontact.adapt.history.at_nodes", lambda space, u: u)
    space = SimpleNamespace(comm=SimpleNamespace(size=1), n_dofs=unknowns)
    scene = SimpleNamespace(frictional=True)
    watch = _watch(SimpleNamespace(space=space), None, scene)
    for number in range(1, steps + 1):
        watch.step(_step(number - 1, 2), number, {})
    assert len(watch.known.times) == len(watch.known.fields) == len(watch.known.alone) == kept
    assert watch.known.every == (kept == steps)
    assert watch.known.times[-1] == watch.known.fields[-1] == steps
