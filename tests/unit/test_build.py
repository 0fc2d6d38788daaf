"""What the command line makes of a scene."""

import pytest

from pcontact.build import override
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import PETSc
from pcontact.runtime.presets import Choice
from pcontact.scene.model import Body, Material, MeshSpec, Output, Scene


def scene(**output):
    return Scene(MeshSpec(__file__), {"m": Material(1.0, 0.3)}, [Body("block", "m")], output=Output(**output))


def overridden(case, **said):
    database = PETSc.Options()
    for name, value in said.items():
        database.setValue(name, value)
    try:
        return override(case, Options(), Choice())
    finally:
        for name in said:
            database.delValue(name)


@pytest.mark.parametrize(
    ("output", "said", "writes", "every"),
    [
        ({}, {}, False, 1), ({"checkpoint": True}, {}, True, 1), ({"checkpoint_every": 5}, {}, True, 5),
        ({"checkpoint": False, "checkpoint_every": 5}, {}, False, 5), ({}, {"checkpoint_every": "3"}, True, 3),
        ({"checkpoint": False}, {"checkpoint_every": "3"}, True, 3),
    ],
)  # fmt: skip
def test_every_so_many_load_steps_means_checkpoints(output, said, writes, every):
    """But a scene that says no has none, unless the command line says otherwise."""
    found = overridden(scene(**output), **said).output
    assert (found.checkpoint, found.checkpoint_every) == (writes, every)
