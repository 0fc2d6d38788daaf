"""Presets of accuracy: what is left open is set to what has been measured to pay (``drivers/studies/tradeoff.py``)."""

from dataclasses import dataclass

from pcontact.runtime.declared import shown

DIRECT = ("lu", "cholesky")


@dataclass(frozen=True)
class Preset:
    """Values that a word stands for.

    Attributes
    ----------
    options : dict of str to object
        Proposed to the options database where contact or plasticity make the problem nonlinear.
    krylov : float or None
        Tolerance that inexact linear solves (Eisenstat, Walker) begin with, and their loosest one; None: as without a
        preset.
    linear : float
        Tolerance of the solve of a linear problem.
    order : int
        Degree of the displacement on a mesh of degree 2. On straight cells degree 2 does not pay for bodies that are
        round: the pressure has the kinks of the facets.
    steps : int
        Load steps over those of the scene, where bodies rub or yield.
    """

    options: dict
    krylov: float | None
    linear: float
    order: int
    steps: int = 1


# Of the forces at work, and of the first residual of a load step: looser ones save next to nothing.
PRESETS = {
    "draft": Preset({"snes_rtol": 1e-4}, 1e-2, 1e-5, 1),
    "standard": Preset({"snes_rtol": 1e-4}, None, 1e-7, 2),
    "fine": Preset({"snes_rtol": 1e-7, "contact_partner_rtol": 1e-4}, None, 1e-9, 2, 2),
}


class Choice:
    """Values that a preset chose in a run, and those that it left to the user's own words.

    Attributes
    ----------
    name : str or None
        No preset, and nothing is chosen.
    chosen, overridden : dict of str to object
        Options, with the preset's value, and with the user's.
    """

    def __init__(self):
        self.name, self.chosen, self.overridden = None, {}, {}

    def order(self, said, degree):
        """Degree of the displacement.

        Parameters
        ----------
        said : int or None
            By the scene or the command line.
        degree : int
            That of the mesh.

        Returns
        -------
        int
        """
        wanted = degree if self.name is None else min(degree, PRESETS[self.name].order)
        if said is not None:
            if self.name is not None and said != wanted:
                self.overridden["mesh_order"] = said
            return said
        if self.name is not None:
            self.chosen["mesh_order"] = wanted
        return wanted

    def steps(self, count, remembers, given):
        """Number of load steps: the preset's, where bodies rub or yield and the command line does not say.

        Parameters
        ----------
        count : int
            Of the scene.
        remembers : bool
            Whether the answer depends on load steps.
        given : bool
            Whether the command line says them.
        """
        times = PRESETS[self.name].steps if self.name is not None and remembers else 1
        if times == 1:
            return count
        if given:
            self.overridden["steps_count"] = count
            return count
        self.chosen["steps_count"] = times * count
        return times * count

    def propose(self, options, linear):
        """Enter the preset's options where the user has none.

        Parameters
        ----------
        options : pcontact.runtime.options.Options
        linear : bool
            Whether one linear solve is all.
        """
        if self.name is None:
            return
        preset = PRESETS[self.name]
        if linear or options.get("pc_type", "gamg") in DIRECT:
            wanted = {"ksp_rtol": preset.linear} if linear else {}
        elif preset.krylov is None:
            wanted = {}
        else:
            wanted = {"snes_ksp_ew_rtol0": preset.krylov, "snes_ksp_ew_rtolmax": preset.krylov}
        if not linear:
            wanted |= preset.options
        applied, kept_out = options.propose(wanted)
        self.chosen |= applied
        self.overridden |= kept_out

    def report(self):
        """Section of the report."""
        return {"preset": self.name, "chosen": self.chosen, "overridden": self.overridden}

    def lines(self):
        """Lines said to the user: none without a preset."""
        if self.name is None:
            return []
        words = [f"{name} {shown(value)}" for name, value in self.chosen.items()]
        lines = [f"accuracy {self.name}: {', '.join(words) or 'nothing left to choose'}"]
        if self.overridden:
            kept = [f"{name} {shown(value)}" for name, value in self.overridden.items()]
            lines.append(f"accuracy {self.name}: yours instead: {', '.join(kept)}")
        return lines
