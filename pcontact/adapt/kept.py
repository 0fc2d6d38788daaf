"""The last mesh of a loop as a file, and the scene that runs on it: an ordinary run of it has the same numbers."""

from dataclasses import replace

from pcontact.mesh.hdf5 import write
from pcontact.mesh.refinement.gather import gathered
from pcontact.runtime import log
from pcontact.runtime.files import replace_file
from pcontact.runtime.parallel import on_root
from pcontact.scene.writer import tables_of, text

MESH, SCENE = "adapted.h5", "adapted.toml"


def keep(directory, mesh, scene, user):
    """Write both. *Collective.*

    Parameters
    ----------
    directory : pathlib.Path
    mesh : pcontact.mesh.mesh.Mesh
    scene : pcontact.scene.model.Scene
        Of the pass on it.
    user : pcontact.scene.model.Scene
        The user's, whose output it has.
    """
    raw = gathered(mesh, directory / MESH, every=True)
    # groups by place are groups of the mesh by now
    scene = replace(scene, mesh=replace(scene.mesh, file=(directory / MESH).absolute()), output=user.output, regions=[])

    def files():
        write(directory / MESH, raw, scene.mesh.order, mesh.curved)
        try:
            tables = tables_of(scene, directory)
        except TypeError as error:
            log.warning("%s: not written: %s; -mesh %s runs the scene on the mesh", SCENE, error, directory / MESH)
            return
        head = ["The scene on its adapted mesh, with the load steps and tolerances of the best pass.",
                f"Other loads on the same mesh: pcontact run SCENE.toml -mesh {MESH}"]  # fmt: skip
        replace_file(directory / SCENE, text(tables, head))

    on_root(mesh.comm, files)
