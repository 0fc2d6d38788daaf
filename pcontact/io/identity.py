"""What a checkpoint belongs to: the mesh, the physics, and the points that remember something."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcontact.mesh.mesh import hashes, mesh_digest, total
from pcontact.scene import differences, physics_so_far
from pcontact.scene.model import OUTER
from pcontact.scene.places import groups_named, tables

# of the mesh: what a state cannot go on without
NEEDED = "cells"
SAID = {
    "cells": "cells of other nodes, or other numbers",
    "points": "nodes at other places",
    "groups": "other members",
}


@dataclass
class Difference:
    """Between a run and the one that wrote a checkpoint.

    Attributes
    ----------
    key : str
        File and key.
    found, allowed : str
        What the run has there, and what the checkpoint is of.
    final : bool
        Whether the state cannot be that of the run, whatever the user says.
    """

    key: str
    found: str
    allowed: str
    final: bool


@dataclass
class Identity:
    """Of a run, or of the one that wrote a checkpoint.

    Attributes
    ----------
    physics : dict
        See :func:`pcontact.scene.physics.physics`.
    mesh : dict of str to str
        See :func:`pcontact.mesh.mesh.mesh_digest`.
    rows : dict of str to [int, str]
        Of every item that remembers something: how many points (or cells) there are, and a digest of their numbers.
    scene_file, mesh_file : str or pathlib.Path
        What messages call them; of a run.
    """

    physics: dict
    mesh: dict
    rows: dict
    scene_file: str | Path = ""
    mesh_file: str | Path = ""

    @classmethod
    def of(cls, scenes, space, items):
        """That of a run. *Collective.*

        Parameters
        ----------
        scenes : list of pcontact.scene.model.Scene
            With what the command line says; those of the phases so far, one after the other.
        space : pcontact.space.space.Space
        items : list
            Those that remember something.
        """
        rows = {}
        for item in items:
            keys = item.memory_keys()
            rows[item.name] = [space.comm.allreduce(len(keys)), total(space.comm, hashes(keys))]
        regions = set().union(*(_regions(scene) for scene in scenes))
        mesh = mesh_digest(space.mesh, space.mesh_nodes[space.owned_local], regions)
        return cls(physics_so_far(scenes), mesh, rows, scenes[0].where, scenes[0].mesh_path)

    @classmethod
    def read(cls, data):
        """That of a checkpoint, from bytes (n,) that :meth:`written` gave."""
        return cls(**json.loads(bytes(data)))

    def written(self):
        """The same as bytes, an ndarray (n,) uint8."""
        data = {"physics": self.physics, "mesh": self.mesh, "rows": self.rows}
        return np.frombuffer(json.dumps(data).encode(), dtype=np.uint8)

    def differences(self, then, time):
        """Where a run is not what a checkpoint is of.

        Parameters
        ----------
        then : Identity
            Of the checkpoint.
        time : float
            Of the checkpoint.

        Returns
        -------
        list of Difference
            What the user has written comes first.
        """
        found = [
            Difference(f"{self.scene_file}: {key}", now, old, False)
            for key, now, old in differences(then.physics, self.physics, time)
        ]
        # groups that only one of both uses differ in the physics
        for key in sorted(self.mesh):
            if self.mesh[key] != then.mesh.get(key, self.mesh[key]):
                now, old = SAID[key.partition(".")[0]], f"digest {then.mesh[key]}"
                found.append(Difference(f"{self.mesh_file}: {key}", now, old, key == NEEDED))
        for name in self.rows:
            if self.rows[name] != then.rows.get(name, self.rows[name]):
                now, old = (f"{rows} of digest {sum_}" for rows, sum_ in (self.rows[name], then.rows[name]))
                found.append(Difference(f"{self.scene_file}: points or cells of {name}", now, old, True))
        return found


def _regions(scene):
    """Groups that the physics of a scene is about."""
    return {name for _, table in tables(scene) for _, name, _ in groups_named(table) if name != OUTER}
