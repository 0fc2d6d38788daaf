"""From the estimates of the cells of a pass to the mesh of the next one."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcontact import build
from pcontact.adapt.mark import NAMES, Choice, Contributions, Cuts, degrees, locking, next_cuts, of_parts, parts_of
from pcontact.mesh.refinement.refine import HALVED, SIMPLICES, Balance, refine
from pcontact.mesh.refinement.split import split


class Step(NamedTuple):
    """Way to cut the cells of a mesh.

    Attributes
    ----------
    cuts : pcontact.adapt.mark.Cuts
        Of the simplices of each cell, where the mesh is divided.
    divided : bool
        Whether the cells are divided into simplices first.
    """

    cuts: Cuts
    divided: bool = False


class Cut(NamedTuple):
    """A mesh whose cells have been cut.

    Attributes
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    fields : list of ndarray (n_nodes, k)
    whole : bool
        Whether its cells are no simplices.
    """

    mesh: object
    fields: list
    whole: bool = True


class Refining:
    """Refines the meshes of a loop: where it pays, or, of cells that are no simplices, as a whole.

    Parameters
    ----------
    comm : MPI.Comm
    settings : pcontact.adapt.settings.Settings
    options : pcontact.runtime.options.Options

    Attributes
    ----------
    whole : bool
        Whether the cells of the last mesh are no simplices.
    choice : pcontact.adapt.mark.Choice
        Of what becomes of them.
    """

    def __init__(self, comm, settings, options):
        self._comm, self._settings, self._options = comm, settings, options
        self.whole, self.choice = False, Choice(comm)

    def first(self, scene):
        """The mesh of the file, divided where it has cells that the estimate does not know, or that nothing halves.
        *Collective.*

        Parameters
        ----------
        scene : pcontact.scene.model.Scene
            Its order becomes 2 where the user does not say, and so many unknowns are few, or simplices of degree 1
            would be too stiff.

        Raises
        ------
        InputError
        """
        said = self._settings.degree.now
        # read as the user says: with a geometry cells are to be curved with either degree
        mesh = build.read(
            replace(scene, mesh=replace(scene.mesh, order=said)),
            self._comm,
            self._options,
            lambda raw: 2 if self._settings.degree.few(raw.dim, 2**raw.dim * len(raw.points)) else 1,
        )
        own = {block.cell for block in mesh.blocks if len(block.nodes)}
        kinds = set().union(*self._comm.allgather(own))
        self.whole = not kinds <= set(SIMPLICES)
        stiff = locking(scene, 1) if self.whole and not mesh.curved else None
        why = self._settings.degree.few(mesh.dim, mesh.n_nodes_total * (1 if mesh.degree == 2 else 2**mesh.dim))
        if stiff is not None:
            why = f"{NAMES[mesh.dim]} of degree 1 would be too stiff in {stiff} (locking)"
        if said is None and why:
            scene.mesh.order = self._settings.degree.take(2, why)
            mesh = build.read(scene, self._comm, self._options) if mesh.degree == 1 else mesh
        if not self.whole:
            return mesh
        if kinds <= set(HALVED):
            return mesh
        self.choice.must(kinds, mesh.dim)
        self.whole = False
        return split(mesh, (), Balance(*build.balance(scene, self._options))).mesh

    def step(self, space, squares, wanted, most, known, divided=False):
        """Way to cut the cells of the last pass: a :class:`Step`. *Collective.*

        `squares` is what they have in the squared error, `wanted` the part of the error in the energy norm to be left
        (where cells are `divided` first, of that of the simplices), `most` the growth of the number of cells at most,
        `known` whether the rate is known at which the error falls.
        """
        degree, dim = degrees(space, self.whole and not divided), space.dim
        if divided:
            parts = parts_of(space.mesh)
            errors = Contributions(of_parts(squares, parts, dim, degree), degree, dim, parts)
        else:
            level = None if space.mesh.origin is None else space.mesh.origin.level
            errors = Contributions(squares, degree, dim, whole=self.whole, level=level)
        return Step(next_cuts(self._comm, errors, wanted, most, known), divided)

    def cut(self, mesh, step, fields, scene):
        """The next mesh, a :class:`Cut`, spread over the ranks for a scene. *Collective.*"""
        balance, more = Balance(*build.balance(scene, self._options)), step.cuts.more
        if self.whole and not step.divided:
            for _ in range(round(np.log2(step.cuts.growth) / mesh.dim)):
                n = sum(len(block.nodes) for block in mesh.blocks)
                mesh, fields = refine(mesh, np.ones(n, dtype=np.int64), fields, balance)
            return Cut(mesh, fields)
        if step.divided:
            mesh, fields, more = split(mesh, fields, balance, cells=more)
        return Cut(*refine(mesh, more, fields, balance), False)
