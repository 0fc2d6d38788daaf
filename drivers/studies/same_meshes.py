"""Whether any number of ranks makes the same meshes on the way to an error that is named.

Scenes of `_named_scenes.py`, as ``SCENE,OF,TARGET``. A line for each pass has the unknowns, the load steps, a digest of
the mesh and the error named. The digest is that of the corners of all cells, sorted, with coordinates that are rounded
to 1e-9 of the size of the mesh: it does not depend on how ranks number and share them. Files of several numbers of
ranks are compared with each other by ``diff``; `passes.json` has the numbers with all digits:

    for n in 1 2 3 4; do mpirun -n $n python drivers/studies/same_meshes.py --run wound,force:circle,0.01 -o on_$n; done
    for n in 2 3 4; do diff on_1/passes.txt on_$n/passes.txt; done
"""

import hashlib
import json
from dataclasses import replace

import numpy as np

from drivers._common import log, main, make_parser
from drivers.studies._named_scenes import HELD_BACK, SCENES
from pcontact.adapt.loop import Loop
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.target import Target

ALL = SCENES | HELD_BACK
# [-] Of the size of a mesh, to which coordinates are rounded.
ROUNDED = 1e-9
TINY = ("sheared,energy,0.02",)


def digest(mesh):
    """A word for the cells of a mesh, the same on any number of ranks. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh

    Returns
    -------
    str
    """
    comm, hashed = mesh.comm, hashlib.sha1()
    size = comm.allreduce(float(np.abs(mesh.points).max(initial=0.0)), op=MPI.MAX)
    places = np.rint(mesh.points / (ROUNDED * size)).astype(np.int64)
    tables = {}
    for block in mesh.blocks:
        corners = places[block.nodes]
        # of each cell the corners by their coordinates, the last one first
        for k in range(mesh.dim):
            order = np.argsort(corners[:, :, k], axis=1, kind="stable")
            corners = np.take_along_axis(corners, order[:, :, None], axis=1)
        tables.setdefault(block.cell, []).append(corners.reshape(len(corners), corners.shape[1] * mesh.dim))
    found = comm.gather({cell: np.concatenate(some) for cell, some in tables.items()})
    for cell in sorted(set().union(*found)) if comm.rank == 0 else ():
        rows = np.concatenate([one[cell] for one in found if cell in one])
        hashed.update(np.ascontiguousarray(rows[np.lexsort(rows.T)]).tobytes())
    return comm.bcast(hashed.hexdigest()[:10])


def passes(scene, target, comm=MPI.COMM_WORLD):
    """Digests of the meshes of a loop, and its passes. *Collective.*

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
    target : pcontact.scene.target.Target
    comm : MPI.Comm

    Returns
    -------
    digests : list of str
    passes : list of pcontact.adapt.passes.Pass
    """
    scene, digests = scene.copy(), []
    if target.quantity == "displacement":
        scene.output.probes = [target.name]
    loop = Loop(replace(scene, accuracy=target), comm, take=lambda run, _: digests.append(digest(run.mesh)))
    loop.run()
    return digests, loop.passes


def run(args):
    comm, lines, numbers = MPI.COMM_WORLD, [], []
    for words in TINY if args.tiny else args.run:
        name, of, error = words.split(",")
        found = passes(ALL[name].scene(args.o), Target(float(error), of))
        for number, (word, one) in enumerate(zip(*found, strict=True), 1):
            lines.append(f"{words} pass {number} unknowns {one.unknowns} steps {one.steps} mesh {word} "
                         f"error {one.error:.3g}")  # fmt: skip
            numbers.append({"run": words, "pass": number, "mesh": word, "error": one.error, "parts": one.parts,
                            "quantity": one.quantity})  # fmt: skip
            log.info("%s", lines[-1])
        on_root(comm, (args.o / "passes.txt").write_text, "\n".join([*lines, ""]))
        on_root(comm, (args.o / "passes.json").write_text, json.dumps(numbers, indent=1))
    return 0


if __name__ == "__main__":
    parser = make_parser(__doc__, "same_meshes")
    parser.add_argument("--run", nargs="+", default=TINY, metavar="SCENE,OF,TARGET", help="(default: %(default)s)")
    main(run, parser)
