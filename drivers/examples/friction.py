"""Friction: the force that drags a block along another one over the coefficient of friction, from Python.

    python -m meshes two_blocks --widths 3,1 --heights 1,0.25 --offset 0.5 --n-lower 24,8 --n-upper 10,4 -o drivers/examples/drag.msh
    python drivers/examples/friction.py

The scene is that of drag.toml. Each run ends as soon as no point sticks: from there on the force is the coefficient times
the normal force, 1. Works on several ranks, too: mpirun -n 2 python drivers/examples/friction.py
"""  # noqa: E501

import math
from pathlib import Path

from mpi4py import MPI

import pcontact as pc

SCENE = Path(__file__).parent / "drag.toml"


def slides(step):
    """Whether the block is dragged and no point sticks at the end of a load step."""
    return step.time > 1.0 and step.report["contacts"]["drag"]["stick"] == 0


def drag(path, friction):
    """Time at which the block slides, and the forces on the lower one then.

    Parameters
    ----------
    path : pathlib.Path
        Of the scene.
    friction : float
        Coefficient of Coulomb's law.

    Returns
    -------
    time, tangential, normal : float
        The time is NaN if some point sticks to the end.
    """
    scene = pc.read(path, contacts={"drag": {"friction": friction}}, steps={"count": 20})
    run = pc.run(scene, on_step=lambda step: not slides(step))
    history = run.history
    time = history["time"][-1] if run.stopped else math.nan
    return time, history["contacts.drag.force_x"][-1], -history["contacts.drag.force_y"][-1]


def main():
    """The table."""
    for friction in (0.1, 0.3, 0.5):
        time, tangential, normal = drag(SCENE, friction)
        if MPI.COMM_WORLD.rank == 0:
            print(f"friction {friction}: slides from time {time:.4g}, force {tangential:.4f} under {normal:.4f}")


if __name__ == "__main__":
    main()
