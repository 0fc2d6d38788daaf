"""Steps of a deck: one run through all, or a phase for each where supports, contacts or elements come, go or change."""

import math
from dataclasses import dataclass, field

from pcontact.importer.contacts import name_of

# cards that say what a program writes, or how it iterates
OUTPUT = ("", "HEADING", "NODEPRINT", "ELPRINT", "NODEFILE", "ELFILE", "CONTACTFILE", "CONTACTPRINT", "OUTPUT",
          "NODEOUTPUT", "ELEMENTOUTPUT", "CONTACTOUTPUT", "ENERGYPRINT", "ENERGYFILE", "TIMEPOINTS", "CONTROLS",
          "RESTART", "PREPRINT", "FILEFORMAT", "SECTIONPRINT", "MONITOR", "PRINT", "CONTACTCONTROLS", "ENDSTEP",
          "PHYSICALCONSTANTS")  # fmt: skip
PROCEDURES = ("DYNAMIC", "FREQUENCY", "HEATTRANSFER", "COUPLEDTEMPERATURE-DISPLACEMENT", "VISCO", "BUCKLE",
               "UNCOUPLEDTEMPERATURE-DISPLACEMENT", "STEADYSTATEDYNAMICS", "MODALDYNAMIC", "GREEN", "SENSITIVITY",
               "COMPLEXFREQUENCY", "ELECTROMAGNETICS", "NOANALYSIS", "CRACKPROPAGATION", "ROBUSTDESIGN")  # fmt: skip
# load steps that a run, or a phase, is planned with at most
_MOST = 1000
# load steps of a deck that the scene takes as they are; more are where it begins, and they may grow
FEW = 20
# where a static step says its longest increment
_LONGEST = 3
# how elements may be added; without a word without strain
STRAIN_FREE, WITH_STRAIN = ("", "STRAINFREE"), "WITHSTRAIN"


@dataclass
class Run:
    """The static steps.

    Attributes
    ----------
    periods : list of (float, int)
        Duration and load steps of each.
    longest : float or None
        Largest load step, where their size is left to the program [time].
    finite : Card or None
        The first step that asks for finite strain.
    phased : bool
        Whether each is a phase.
    friction : list of dict of str to float
        Coefficients of each that are not the contacts' own.
    off : list of set of str
        Contacts that do not act in each.
    """

    periods: list = field(default_factory=list)
    longest: float | None = None
    finite: object = None
    phased: bool = False
    friction: list = field(default_factory=list)
    off: list = field(default_factory=list)

    @property
    def names(self):
        """Names of the phases; none in a run without."""
        return [f"step_{k}" for k in range(1, len(self.periods) + 1)] if self.phased else []

    @property
    def ramp_end(self):
        """End of the ramp that a value without an amplitude has; infinite where none has it."""
        return math.inf if self.phased else sum(period for period, _ in self.periods) or 1.0

    def acting(self, name):
        """The key of the phases in which a contact acts, if it does not in all."""
        acts = [phase for phase, off in zip(self.names, self.off, strict=False) if name not in off]
        return {} if len(acts) == len(self.names) else {"phases": acts}

    def _control(self):
        """Keys of load steps that grow where they go well; of a few equal ones none."""
        if self.longest is None or all(count <= FEW for _, count in self.periods):
            return {}
        return {"control": "auto", "max_step": self.longest}

    def tables(self):
        """Tables of the scene, see :func:`pcontact.scene.writer.text`."""
        if not self.phased:
            shortest = min((period / count for period, count in self.periods), default=math.inf)
            count = 1 if math.isinf(shortest) else min(_MOST, max(1, round(self.ramp_end / shortest)))
            return [("[steps]", {"end": self.ramp_end, "count": count, **self._control()}, "")]
        tables = [("[steps]", self._control(), "")] if self._control() else []
        for name, (period, count), friction in zip(self.names, self.periods, self.friction, strict=True):
            one = {"name": name, "duration": period, "count": count} | ({"friction": friction} if friction else {})
            tables.append(("[[phases]]", one, ""))
        return tables


def read_steps(deck, findings, supports, contacts, changing=False):
    """Take all steps of a deck.

    Parameters
    ----------
    deck : Deck
    findings : Findings
    supports : pcontact.importer.supports.Supports
    contacts : pcontact.importer.contacts.Contacts
    changing : bool
        Whether elements are there in some steps only.

    Returns
    -------
    Run
    """
    supports.before()
    run, begin, small, friction, off, begun = Run(), 0.0, None, {}, set(), []
    for step in deck.steps:
        findings.know(step.card, "NLGEOM", "INC", "AMPLITUDE", "NAME", "PERTURBATION", "SOLVER", "UNSYMM")
        findings.take(step.card)
        if not _static(step, findings):
            continue
        period, count, longest = _period(step, findings)
        run.longest = max(run.longest or 0.0, longest)
        if "NLGEOM" in step.card.parameters and step.card.word("NLGEOM") != "NO":
            run.finite = run.finite or step.card
        elif run.finite is None:
            small = small or step.card
        friction, off = dict(friction), set(off)
        for card, following in zip(step.cards, [*step.cards[1:], None], strict=False):
            if card.key in ("CHANGEFRICTION", "CHANGESURFACEBEHAVIOR"):
                friction |= contacts.change(card, following)
            elif card.key == "MODELCHANGE":
                for name, on in contacts.switch(card):
                    (off.discard if on else off.add)(name)
        run.friction.append({name: value for name, value in friction.items() if name not in off})
        run.off.append(off)
        for old, new, _ in contacts.begun[len(begun) :]:
            begun.append(name_of(new))
            off.add(name_of(old))
            for before in run.off[:-1]:
                before.add(name_of(new))
        supports.step(step, begin, begin + period)
        run.periods.append((period, count))
        begin += period
    if run.finite is not None and small is not None:
        findings.change(small, "finite strain in this step, too")
    run.phased = len(run.periods) > 1 and (changing or supports.changes or any(run.friction) or any(run.off))
    if len(run.periods) == 1:
        _alone(run, deck, findings)
    return run


def _alone(run, deck, findings):
    """A run of one step has no phases: what changes in it does so from the beginning."""
    if any(run.friction) or any(run.off):
        findings.leave(deck.steps[0].card, "contacts that change in the only step")


def is_static(step):
    """Return whether it is a static step from the state before it."""
    return "PERTURBATION" not in step.card.parameters and not any(card.key in PROCEDURES for card in step.cards)


def _static(step, findings):
    """Return whether it is a static step; what is left out of it."""
    other = next((card for card in step.cards if card.key in PROCEDURES), None)
    if other is not None:
        findings.leave(other, "a step that is not static")
        for card in step.cards:
            if card is not other and card.key not in OUTPUT:
                findings.leave(card, "of a step that is not static")
        return False
    if "PERTURBATION" in step.card.parameters:
        findings.leave(step.card, "a linear step about the state before it")
    return True


def _period(step, findings):
    """Duration of a step, load steps to begin with, and the longest of them."""
    period, first, longest = 1.0, None, None
    for card in step.cards:
        if card.key == "STATIC":
            findings.know(card, "DIRECT", "SOLVER", "STABILIZE", "TOTALREWINDTIME")
            findings.take(card)
            values = card.numbers(*card.rows[0]) if card.rows else []
            period = values[1] if len(values) > 1 and values[1] > 0.0 else 1.0
            first = values[0] if values and values[0] > 0.0 else None
            longest = values[3] if len(values) > _LONGEST and values[_LONGEST] > 0.0 else None
    return period, min(_MOST, max(1, round(period / (first or period)))), longest or period


class Presence:
    """Elements that are there, by static step.

    Elements that are there in none of them are taken out of the deck.

    Parameters
    ----------
    deck : pcontact.importer.deck.Deck
    findings : pcontact.importer.translate.Findings

    Attributes
    ----------
    gone : list of set of int
        Elements that are absent in each step.
    added : dict of int to Card
        What adds elements.
    """

    def __init__(self, deck, findings):
        self.gone, self.added, cards, absent = [], {}, [], set()
        for step in filter(is_static, deck.steps):
            absent = set(absent)
            for card in step.cards:
                if card.key == "MODELCHANGE" and card.word("TYPE") == "ELEMENT":
                    cards.append((card, self._take(deck, findings, card, absent, bool(self.gone))))
            self.gone.append(absent)
        never = set.intersection(*self.gone) if self.gone else set()
        for card, elements in cards:
            if elements and elements <= never:
                findings.change(card, "not there from the beginning; the surfaces that they have are in no contact")
            elif elements:
                findings.change(card, "what they have borne ramps to zero" if "REMOVE" in card.parameters else
                                "what else begins with the step does so along a ramp")  # fmt: skip
        if never:
            deck.remove(never)
            deck.removed = next(card for card, elements in cards if elements & never)

    def _take(self, deck, findings, card, absent, later):
        """Take elements out of those that are absent, or into them; the elements of the card."""
        findings.know(card, "TYPE", "ADD", "REMOVE")
        if not {"ADD", "REMOVE"} & set(card.parameters):
            findings.leave(card, "allowed: ADD or REMOVE")
            return set()
        elements = {e for place, words in card.rows for word in words if word
                    for e in deck.elements_of(card, place, word)}  # fmt: skip
        if "REMOVE" in card.parameters:
            absent |= elements
            return elements
        how = card.word("ADD")
        if how == WITH_STRAIN:
            findings.leave(card, "WITH STRAIN: the elements begin without strain")
        elif how not in STRAIN_FREE:
            findings.leave(card, f"ADD={card.get('ADD')}; allowed: STRAIN FREE")
        if later:
            self.added |= dict.fromkeys(elements & absent, card)
        absent -= elements
        return elements

    @property
    def changes(self):
        """Return whether elements are there in some steps only."""
        return any(one != self.gone[0] for one in self.gone)

    def split(self, parts):
        """Parts (name, material, elements) of which all elements are there in the same steps."""
        if not self.changes:
            return parts
        found = []
        for name, material, cells in parts:
            kinds = {}
            for e in cells:
                kinds.setdefault(tuple(e in gone for gone in self.gone), []).append(e)
            found += [(name if k == 0 else f"{name}_{k + 1}", material, some) for k, some in enumerate(kinds.values())]
        return found

    def keys(self, cells, names, finite, findings):
        """Keys of the body of some elements that are there in the same steps.

        Parameters
        ----------
        cells : list of int
        names : list of str
            Of the phases.
        finite : bool
            Whether bodies have finite strain.
        findings : pcontact.importer.translate.Findings
        """
        there = [name for name, gone in zip(names, self.gone, strict=False) if cells[0] not in gone]
        if len(there) == len(names):
            return {}
        if finite and cells[0] in self.added:
            findings.change(self.added[cells[0]], "NLGEOM: elements that are added have small strain")
            return {"phases": there, "strain": "small"}
        return {"phases": there}
