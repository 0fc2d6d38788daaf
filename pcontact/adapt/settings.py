"""Settings that the passes run with: load steps, tolerances and the degree of the displacement."""

from dataclasses import replace

import numpy as np

from pcontact.adapt.mark import LEAP
from pcontact.runtime import log
from pcontact.runtime.petsc import MOST_UNKNOWNS
from pcontact.scene.amplitude import corners
from pcontact.scene.keys import options as key_options
from pcontact.scene.model import MeshSpec
from pcontact.scene.target import SMALLEST
from pcontact.stepping.schedule import filled

# [-] Part of the target that the mesh has at least, and tolerances at most. From: chosen.
SHARE = 0.1
# [-] Part of the target that next meshes and load steps are made for. From: what just misses it costs another pass.
AIM = 0.85
# [-] Part of a budget that a mesh has to fill, where it is the limit; its root is aimed at; and of the free memory that
# a run may take. From: chosen; the error falls with the root of the unknowns, or faster.
FULL = 0.85
# [-] Part of the target that errors which are not of the mesh may have before each is tried alone, and refined. From:
# chosen; the mesh, by far the dearest, has the rest.
THIRD = 1.0 / 3.0
# parts of the error that finer meshes take away, and those that are due to the shape of facets
FALLING, FACETS = ("mesh", "quadrature", "loads"), ("straight_facets", "curved_facets")
# [-] Tolerance of Newton's method where norms are named; the least one, `NOTICED` times as much, has what are numbers,
# whose changes are products of two of them. What is left depends on how many ranks there are, whose preconditioners
# differ, and so do the squares of cells, and the next mesh. From: Hertz's cylinder and rings, whose squares differ by
# 1e-4 with 1e-4 and by 1e-8 with 1e-8; the force of a wound laminate, of which facets change a part that differs by
# 1e-4 with 1e-8. With 1e-8 instead of 1e-3 loops take 1.0 to 1.4 times as long. To take it only where another pass is
# expected, and to go on to it where the last one misses, costs more: a third of the last passes miss.
RTOL = 1e-8
# Options of the linear solves of Newton's method [-], where bodies rub.
# From: with looser ones normals under a punch differ by 1e-4 between one rank and two, and one of four numbers of ranks
# takes a lug that closes on its pin to other points that stick: there is more than one solution, and what the solves
# leave decides which. Iterates differ from the fourth one on with 1e-3, on one of four with 1e-5, on none with 1e-7.
# Here they are the tolerance of Newton's method.
FORCING = ("snes_ksp_ew_rtol0", "snes_ksp_ew_rtolmax")
# [-] Part of the target below which what is only known roughly is taken for nothing where meshes are chosen, and that
# frozen partners may have. From: it is less than the margin that meshes are made with.
NOTICED = 0.01
# [unknowns] Below which meshes of the plane are factorised: on one rank, where multigrid solves to small tolerances and
# loops take 0.4 to 0.85 times as long without it, and on any number where bodies yield or rub. From: all for which
# there are factors; a ball pressed into metal takes 0.6 times as long so on 12,776 unknowns, 0.7 times with
# friction on 3,000. Beside multigrid and linear solves to 1e-3, loops of laminates (1 and 2 %) take 0.6 times as long
# on one rank, those of a lug on a pin 1.0, that of Cattaneo's cylinder (1 %), which contact alone holds, 0.5; on two
# ranks 1.0, 0.9 and 0.7. Beside multigrid to 1e-8 the last one takes 0.4, on two ranks 0.5 times as long.
FACTORISED = MOST_UNKNOWNS[2]
# [-] By dimension: entries of the tangent of degree 2 over those of degree 1 on the same simplices. From: nodes in the
# middles of edges, 3 and 7 a vertex, and the mean number of neighbours of each.
ENTRIES = {2: 6.6, 3: 15.0}


# [unknowns] Of degree 2, up to which the first pass has it. From: chosen. On scenes of seeds 0 to 9 loops for the
# energy take 0.5 to 1.2 of the time that they take from degree 1, those for numbers that a first pass of degree 1
# reaches 0.9 to 4.4 times, with a twelfth of the error named at the median.
FEW = 10_000


class Degree:
    """The degree.

    Parameters
    ----------
    given : int or None
        The user's.
    most : float
        Unknowns that the budget allows.

    Attributes
    ----------
    now : int or None
        Of the next pass; None: 1, and it is to be chosen then.
    chosen : dict or None
        For the report: ``degree``, ``why``, and where there was a choice ``entries`` of the tangent: what the error
        takes with degree 1, and what degree 2 has on the same mesh.
    """

    def __init__(self, given, most=np.inf):
        self.now, self.chosen, self._most = given, None, most

    @property
    def is_open(self):
        """Return True if the degree is still to be chosen."""
        return self.now is None

    def take(self, degree, why):
        """Choose a degree, and return it."""
        self.now, self.chosen = degree, {"degree": degree, "why": why}
        log.info("degree %d: %s", degree, why)
        return degree

    def few(self, dim, nodes):
        """Return why the first pass has degree 2, where the unknowns of so many nodes are few; else empty."""
        unknowns = dim * nodes
        return f"about {unknowns:.2g} unknowns are few" if unknowns <= min(FEW, self._most) else ""

    def choose(self, done, error, most):
        """Choose by a pass of degree 1 that has missed an error: 2, unless finer cells of degree 1 reach it with fewer
        entries of the tangent than degree 2 takes on the same mesh, or there is no room (`most`: growth of the unknowns
        that the budget allows)."""
        dim = done.known.dim
        growth = max(done.expected / error, 1.0) ** (dim / done.power)
        if 2.0**dim > most:
            unknowns = 2.0**dim * done.unknowns
            return self.take(1, f"the budget does not allow {unknowns:.2g} unknowns of degree 2")
        words = f"{growth:.2g} times the entries of the tangent for an error of {100.0 * error:.3g} %"
        if growth < ENTRIES[dim]:
            self.take(1, f"finer cells take {words}, degree 2 {ENTRIES[dim]:g} times on the same mesh")
        else:
            self.take(2, f"degree 1 takes {words}, and more than degree 2 where that is much")
        self.chosen["entries"] = {"1": done.entries * growth, "2": done.entries * ENTRIES[dim]}
        return self.now


class Settings:
    """Settings that the next pass runs with.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
        The user's.
    target : pcontact.scene.target.Target
    options : pcontact.runtime.options.Options
    ranks : int

    Attributes
    ----------
    steps : int
        Load steps.
    goal : float
        The target; where it is the least error that the budget allows, a part of that of the last pass.
    degree : pcontact.adapt.settings.Degree
    falling, staying : tuple of str
        Parts of the error that a finer mesh takes away as it does its own, and those that it leaves.
    """

    def __init__(self, scene, target, options, ranks=1):
        self._scene, self._target, self._ranks = scene, target, ranks
        self.steps = scene.steps.count
        self.goal = target.error or THIRD**2
        # new nodes lie on the facets of the first mesh, unless the geometry is known
        self.falling, self.staying = (FALLING, FACETS) if scene.mesh.geometry is None else (FALLING + FACETS, ())
        self._rtol = NOTICED * RTOL if target.numbers else RTOL
        self.degree = Degree(options.get(key_options(MeshSpec)["order"], scene.mesh.order),
                             target.budget.unknowns or np.inf)  # fmt: skip

    def scene(self):
        """The scene of the next pass."""
        scene = self._scene.copy()
        scene.accuracy = None
        if any(one.quantity == "pressure" for one in self._target.each):
            # toward corners the power of the pressure is known with the traction of the source
            scene.contacts = [replace(one, traction=one.traction or "source") for one in scene.contacts]
        scene.output.estimate, scene.steps.count, scene.mesh.order = True, self.steps, self.degree.now or 1
        # looser partners and tolerances than the mesh deserves are no place to save
        ours = {"snes_rtol": f"{self._rtol:.3g}", "contact_partner_rtol": f"{NOTICED * self.goal:.3g}"}
        if self._scene.remembers or self._ranks == 1:
            # what flows hardly changes its volume, and what rubs has iterates that hang on each solve: multigrid takes
            # many iterations. See `FACTORISED`
            ours["pc_direct_below"] = str(FACTORISED)
        if self._scene.frictional:
            # iterates are to be the same on any number of ranks
            ours |= dict.fromkeys(FORCING, f"{RTOL:g}")
        scene.petsc = {**ours, **scene.petsc}
        return scene

    def keep_sources(self, contacts):
        """Take the sources that a run has chosen for contacts of two surfaces: on finer meshes the other one may have
        the smaller facets, and forces would change their signs."""
        chosen = {one.name: one.contact for one in contacts}
        own = [one if one.surfaces is None else replace(one, surfaces=None, **{
            key: getattr(chosen[one.name], key) for key in ("name", "source", "target", "unbiased")
        }) for one in self._scene.contacts]  # fmt: skip
        self._scene = replace(self._scene, contacts=own)

    def scene_of(self, done):
        """The scene of a pass, as it would be run alone."""
        scene = self.scene()
        scene.steps.count, scene.mesh.order = done.steps, done.degree
        return scene

    def follow(self, done):
        """Take a part of the error of a pass as the goal, where it is to be the least one."""
        if self._target.best:
            self.goal = max(THIRD * done.error, SMALLEST)

    def balance(self, done, aim):
        """Plan load steps where a pass says that settings are large beside the error that the next mesh is made for.

        Load steps end at the corners of amplitudes: as many are planned as there is room for between these.
        """
        parts = {name: done.parts.get(name, 0.0) for name in ("load_steps", "quadrature")}
        if sum(parts.values()) > THIRD * aim:
            fair = THIRD * aim / len(parts)
            # errors fall with the number of load steps
            steps = max(self.steps, int(np.ceil(self.steps * min(parts["load_steps"] / (AIM * fair), LEAP))))
            self.steps = filled(self._scene.steps.end, steps, corners(self._scene)) if steps > self.steps else steps
