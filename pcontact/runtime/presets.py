"""Presets of accuracy: what is left open is set to what has been measured to pay (``drivers/tradeoff.py``)."""

from dataclasses import dataclass, field

DIRECT = ("lu", "cholesky")


@dataclass(frozen=True)
class Preset:
    """What a word stands for.

    Attributes
    ----------
    options : dict of str to object
        Proposed to the options database.
    krylov : float
        Tolerance that inexact linear solves (Eisenstat, Walker) begin with, and their loosest one; where one linear
        solve is all, or it is direct, `linear` is its tolerance instead.
    linear : float
    keys : dict of str to object
        Keys of the scene that it does not say: "order" of the mesh, numerics of all contacts.
    """

    options: dict
    krylov: float
    linear: float
    keys: dict = field(default_factory=dict)


PRESETS = {
    "draft": Preset({"snes_rtol": 1e-2}, 1e-1, 1e-3),
    "standard": Preset({"snes_rtol": 1e-4, "contact_search_again": 1}, 1e-2, 1e-5),
    "fine": Preset({"snes_rtol": 1e-6, "contact_search_again": 4}, 1e-2, 1e-8),
}


class Choice:
    """What a preset chose in a run, and what it left to the user's own words.

    Attributes
    ----------
    name : str or None
        No preset, and nothing is chosen.
    chosen, overridden : dict of str to object
        Options (and keys of the scene), with the preset's value, and with the user's.
    """

    def __init__(self):
        self.name, self.chosen, self.overridden = None, {}, {}

    def key(self, name, own, said=None):
        """The preset's value of a key of the scene, where nobody says one; None otherwise.

        Parameters
        ----------
        name : str
        own : object
            What the scene says, of one pair or of many (a list); None: nothing.
        said : object
            What the command line says.
        """
        value = PRESETS[self.name].keys.get(name) if self.name else None
        if value is None:
            return None
        users = [one for one in (own if isinstance(own, list) else [own]) if one is not None]
        if said is not None or users:
            self.overridden[name] = said if said is not None else users[0] if len(users) == 1 else users
        if said is not None or not isinstance(own, list) and users:
            return None
        if not isinstance(own, list) or len(users) < len(own):
            self.chosen[name] = value
        return value

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
        """What is said to the user: nothing without a preset."""
        if self.name is None:
            return []
        words = [f"{name} {_word(value)}" for name, value in self.chosen.items()]
        lines = [f"accuracy {self.name}: {', '.join(words) or 'nothing left to choose'}"]
        if self.overridden:
            kept = [f"{name} {_word(value)}" for name, value in self.overridden.items()]
            lines.append(f"accuracy {self.name}: yours instead: {', '.join(kept)}")
        return lines


def _word(value):
    return f"{value:g}" if isinstance(value, float) else str(value)
