"""The one reader of the options database: the command line wins over the scene, which wins over defaults."""

import difflib
import re
from collections.abc import Mapping

from pcontact.runtime import log
from pcontact.runtime.declared import COMMAND_LINE, FORMER, OPTIONS, PETSC, RENAMED
from pcontact.runtime.errors import InputError, SolverError
from pcontact.runtime.petsc import PETSc, has_package, option_used, unknown_options
from pcontact.runtime.rules import PETSC_VALUE, apply

UNSAID = object()
# what PETSc asks for when the process ends
AT_END = ("options_view", "citations", "memory_view", "get_total_flops", "mpidump", "malloc_dump", "malloc_view",
          "objects_dump", "log_all")  # fmt: skip
# PETSc's error codes: arguments that are wrong or out of range, names that are not known, missing factorisations
OPTION_FAULTS = (62, 63, 86, 92)
# its code for all that a user may have done wrong: of an option where it says so, and of limits of its own
USER_FAULT, OF_OPTION = 83, re.compile(r"option|enum|array entry", re.IGNORECASE)


class Options:
    """Typed, checked access to the options database, with a list of what was asked for.

    Parameters
    ----------
    said : str
        Where the user gives options, for messages.

    Attributes
    ----------
    known : dict of str to pcontact.runtime.declared.Option
        Every option that the program asked for.
    entered : list of str
        Options that `propose` put into the database.
    told : dict
        Those that :meth:`strange` has named.
    """

    def __init__(self, said="command line"):
        self._db, self.said = PETSc.Options(), said
        self.known, self.entered, self._warned, self.told = {}, [], set(), {}

    def given(self, name):
        """Return whether the user set the option."""
        return self._said(name) is not None

    def _said(self, name):
        """The name under which the user set an option: its own or an old one; None where it is not set."""
        names = (name, *(old for old, new in RENAMED.items() if new == name))
        return next((self._new(one) and one for one in names if self._db.hasName(one)), None)

    def _where(self, name):
        """Return where an option was given, for messages: what was proposed and is wrong stands in the scene."""
        return "scene: petsc" if name in self.entered else self.said

    def _new(self, name):
        """The name that an option has now, with a warning, once, where that is another one."""
        if name in RENAMED and name not in self._warned:
            self._warned.add(name)
            log.warning("option -%s is now called -%s; the old name will go", name, RENAMED[name])
        return RENAMED.get(name, name)

    def get(self, option, default=UNSAID):
        """Value of an option.

        Parameters
        ----------
        option : str or pcontact.runtime.declared.Option
            A declared one, or its name.
        default : object
            Returned when the option is not set; absent: the declared one.

        Raises
        ------
        InputError
            When the value has the wrong type or is not allowed.
        """
        if isinstance(option, str):
            option = OPTIONS.get(option) or PETSC[option]
        self.known[option.name] = option
        name = self._said(option.name)
        if name is None:
            return option.default if default is UNSAID else default
        return option.read(self._db.getString(name, ""), self._where(name))

    def beginning(self, words):
        """Options in the database, and their values, whose names begin with one of some words; they count as used."""
        return {name: self._db.getString(name, "") for name in self._db.getAll() if name.startswith(words)}

    def number(self, name):
        """The number that the text of an option of PETSc's is; NaN where it is none."""
        try:
            return float(self._db.getString(name, ""))
        except ValueError:
            return float("nan")

    def refusal(self, name, allowed):
        """The error to raise: the option's name, what was found, what is allowed.

        Returns
        -------
        InputError
        """
        raw = self._db.getString(name, "")
        return InputError(f"{self._where(name)}: -{name}: found {repr(raw) if raw else 'nothing'}; allowed: {allowed}")

    def propose(self, defaults):
        """Enter solver defaults that the user did not set.

        Parameters
        ----------
        defaults : dict of str to object
            A value of None enters a flag without value.

        Returns
        -------
        dict, dict
            What was applied, and what the user's own options kept out.
        """
        applied, kept_out = {}, {}
        for name, value in defaults.items():
            name = self._new(name)
            said = self._said(name)
            if said is not None:
                kept_out[name] = self._db.getString(said, "")
            else:
                # a flag without value is true for PETSc, and the only way to ask for a monitor
                self._db.setValue(name, "" if value is None or value is True or value == "true" else value)
                applied[name] = value
                self.entered.append(name)
        return applied, kept_out

    def replace(self, values):
        """Enter other defaults in the place of those proposed; what the user set stays.

        Parameters
        ----------
        values : dict of str to object
            As for :meth:`propose`.
        """
        for name in values:
            if name in self.entered:
                self._db.delValue(name)
                self.entered.remove(name)
        self.propose(values)

    def fault(self, error):
        """Return PETSc's complaint about an option as the user's error.

        Parameters
        ----------
        error : PETSc.Error

        Returns
        -------
        InputError or None
            Names the options whose values PETSc complains about; None when it complains about something else.
        """
        _, what = _told(error)
        if error.ierr not in OPTION_FAULTS and not (error.ierr == USER_FAULT and OF_OPTION.search(what)):
            return None
        words = re.findall(r"[^\s,;:()']+", what)
        names = [f"-{name} {value}" for name, value in self._db.getAll().items() if value and value in words]
        found = f"{', '.join(names)}: {what}" if names else what
        return InputError(f"PETSc options: found {found}; allowed: what -help lists")

    def unsolved(self, error, comm):
        """Return what the user hears where PETSc could not go on with a linear system.

        Parameters
        ----------
        error : PETSc.Error
            That is no :meth:`fault`.
        comm : MPI.Comm

        Returns
        -------
        SolverError or RuntimeError
            The second one of several ranks: others may have met nothing, and wait.
        """
        where, what = _told(error)
        own = self._db.getString("pc_type", "")
        kinds = ("gamg", *(name for name in ("hypre", "ml") if has_package(name)), "lu")
        others = ", ".join(f"-pc_type {kind}" for kind in kinds if kind != own)
        said = f"PETSc could not solve a linear system ({where}: {what or 'it says no more'}); others to try: {others}"
        return (SolverError if comm.size == 1 else RuntimeError)(said)

    def give(self, options):
        """Enter what the user says; it wins over whatever is proposed later.

        Parameters
        ----------
        options : str or mapping of str to object
            As on a command line, or names and values: None and True are a flag, a list has its entries separated by
            commas.

        Raises
        ------
        InputError
        """
        if isinstance(options, str):
            try:
                self._db.insertString(options)
            except PETSc.Error as error:
                raise InputError(f"{self.said}: found {options!r}; allowed: -name value -name value ...") from error
            return
        if not isinstance(options, Mapping):
            raise InputError(f"{self.said}: found {options!r}; allowed: a dict or a text of options")
        for name, value in options.items():
            if not isinstance(name, str) or not name.strip("-") or any(c.isspace() for c in name):
                raise InputError(f"{self.said}: found an option named {name!r}; allowed: names without blanks")
            text = "" if value is None or value is True else apply(PETSC_VALUE, value, self.said, name)
            self._db.setValue(name.lstrip("-"), text)

    def withdraw(self):
        """Take all that was proposed back out of the database."""
        for name in self.entered:
            self._db.delValue(name)
        self.entered.clear()

    def strange(self):
        """Lines about options that neither the program nor PETSc knows, whatever is set up later, and about those that
        it had once.

        Notes
        -----
        To be asked when all options that replace keys of the scene have been asked for.
        """
        ours = {*OPTIONS, *RENAMED, *self.known, *COMMAND_LINE}
        names = [name.lstrip("-") for name in self._db.getAll()]
        lines = [f"option -{name} does nothing any more: {FORMER[name]}" for name in FORMER if self._db.hasName(name)]
        self.told = unknown_options([name for name in names if name not in {*ours, *FORMER}])
        for name, near in self.told.items():
            near = next(iter(difflib.get_close_matches(name, ours, 1, 0.8)), near)
            hint = f"; the nearest is -{near}" if near else ""
            lines.append(f"option -{name}: neither pcontact nor PETSc has it{hint}")
        return lines

    def unused(self, ours=()):
        """Options that the user gave and nothing asked for.

        Parameters
        ----------
        ours : sequence of str
            Names that the command line parser has dealt with.

        Returns
        -------
        list of str
        """
        names = [name.lstrip("-") for name in self._db.getAll()]
        for name in (*COMMAND_LINE, *AT_END):
            # whoever asks for it takes it from the list of -options_left
            self._db.hasName(name)
        return [name for name in names if name not in ours and not option_used(name)]


def _told(error):
    """Return the place where PETSc ended, and what it says there."""
    lines = [re.sub(r"^\[\d+\] *", "", line) for line in str(error).strip().splitlines()]
    places = [found[1] for line in lines if (found := re.match(r"(\w+)\(\) at ", line))]
    return (places or [f"error {error.ierr}"])[-1], "" if lines[-1].startswith("error code") else lines[-1].rstrip(". ")
