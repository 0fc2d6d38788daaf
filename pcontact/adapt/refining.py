"""From the estimates of the cells of a pass to the mesh of the next one."""

from typing import NamedTuple

import numpy as np

from pcontact import build
from pcontact.adapt.corners import Corners
from pcontact.adapt.sizes import Contributions, Cuts, degrees, next_cuts
from pcontact.mesh.refinement.refine import SIMPLICES, Balance, refine
from pcontact.mesh.refinement.regular import HALVED
from pcontact.runtime import log
from pcontact.runtime.messages import input_error


class Step(NamedTuple):
    """How to cut the cells of a mesh.

    Attributes
    ----------
    cuts : pcontact.adapt.sizes.Cuts
    rise : pcontact.mesh.refinement.refine.Rise or None
    around : sequence of ndarray (n_nodes, 3)
        What the next mesh has to know of this one, see :class:`pcontact.adapt.corners.Corners`.
    """

    cuts: Cuts
    rise: object
    around: tuple


class Refining:
    """Refines the meshes of a loop: where it pays, or, of cells that are no simplices, as a whole.

    Parameters
    ----------
    comm : MPI.Comm
    options : pcontact.runtime.options.Options

    Attributes
    ----------
    corners : pcontact.adapt.corners.Corners or None
        None where all cells are halved.
    """

    def __init__(self, comm, options):
        self._comm, self._options, self.corners = comm, options, None

    @property
    def whole(self):
        """Whether all cells are halved together."""
        return self.corners is None

    def look_at(self, simulation, where):
        """Refuse cells that cannot be cut, say so where all are. *Collective.*

        Parameters
        ----------
        simulation : pcontact.simulation.Simulation
            On the mesh of the file.
        where : str
            The scene, for messages.

        Raises
        ------
        InputError
        """
        own = {block.cell for block in simulation.mesh.blocks if len(block.nodes)}
        kinds = set().union(*self._comm.allgather(own))
        if kinds <= set(SIMPLICES):
            self.corners = Corners(self._comm)
        elif kinds <= set(HALVED):
            log.info("%s: passes cut all of them, in %d parts each; triangles and tetrahedra are cut where it pays",
                     ", ".join(f"{kind}s" for kind in sorted(kinds)), 2**simulation.mesh.dim)  # fmt: skip
        else:
            simulation.free()
            found = f"{', '.join(sorted(kinds))} cells together with accuracy.error"
            allowed = f"triangles, tetrahedra; or {', '.join(f'{kind}s' for kind in HALVED[1:])} (and triangles)"
            raise input_error(where, "mesh.file", found, allowed)

    def look(self, space, squares):
        """What the last mesh tells of singular points, see :meth:`pcontact.adapt.corners.Corners.look`.
        *Collective.*"""
        return (None, None, ()) if self.whole else self.corners.look(space, squares)

    def step(self, space, squares, seen, wanted, most, known):
        """How to cut the cells. *Collective.*

        Parameters
        ----------
        space : pcontact.space.space.Space
            Of the last pass.
        squares : ndarray (n_cells,)
            What they have in the squared error.
        seen : tuple
            Of :meth:`look`.
        wanted : float
            The part of the error in the energy norm to be left.
        most : float
            Growth of the number of cells at most.
        known : bool
            Whether the rate is known at which the error falls.

        Returns
        -------
        Step
        """
        power, rise, around = seen
        level = None if space.mesh.origin is None else space.mesh.origin.level
        degree = degrees(space, self.whole)
        errors = Contributions(squares, degree, space.dim, power=power, whole=self.whole, level=level)
        return Step(next_cuts(self._comm, errors, wanted, most, known), rise, around)

    def cut(self, mesh, step, fields, scene):
        """The next mesh and fields (n_nodes, k) on it, spread over the ranks for a scene. *Collective.*"""
        balance = Balance(*build.balance(scene, self._options))
        if self.whole:
            for _ in range(round(np.log2(step.cuts.growth) / mesh.dim)):
                n = sum(len(block.nodes) for block in mesh.blocks)
                mesh, fields = refine(mesh, np.ones(n, dtype=np.int64), fields, balance)
            return mesh, fields
        finer, fields = refine(mesh, step.cuts.more, [*fields, *step.around], balance, step.rise)
        self.corners.take(fields[len(fields) - len(step.around) :])
        return finer, fields[: len(fields) - len(step.around)]
