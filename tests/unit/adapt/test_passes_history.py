"""Where the bodies were, for the next mesh."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcontact.adapt.passes import ROOM, Beginning, Known, Watch


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


@pytest.mark.parametrize("unknowns, steps, kept", [(100, 60, 60), (ROOM // 192, 24, 24), (ROOM // 192, 25, 13)])
def test_load_steps_that_there_is_room_for(unknowns, steps, kept, monkeypatch):
    """All of them on small meshes; else every other one, and the last."""
    monkeypatch.setattr("pcontact.adapt.passes.at_nodes", lambda space, u: u)
    space = SimpleNamespace(comm=SimpleNamespace(size=1), n_dofs=unknowns)
    estimate = SimpleNamespace(squares=None, over_steps=0.0, last={"algebraic": 0.0, "energy_norm": 0.0})
    watch = Watch(SimpleNamespace(problem=SimpleNamespace(space=space), begin=None, error_estimate=estimate))
    for number in range(1, steps + 1):
        watch.step(SimpleNamespace(time=float(number), unbalanced=None), number, {})
    assert len(watch.known.times) == len(watch.known.fields) == kept
    assert watch.known.every == (kept == steps)
    assert watch.known.times[-1] == watch.known.fields[-1] == steps
