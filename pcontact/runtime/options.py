"""The one reader of the options database: the command line wins over the scene, which wins over defaults."""

from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import PETSc, option_used


class Options:
    """Typed, checked access to the options database, with a list of what was asked for.

    Attributes
    ----------
    known : dict of str to str
        Help text of every option that the program asked for.
    """

    def __init__(self):
        self._db = PETSc.Options()
        self.known = {}

    def given(self, name):
        """Whether the user set the option."""
        return self._db.hasName(name)

    def get(self, name, default, kind=str, allowed=None, text=""):
        """Value of an option.

        Parameters
        ----------
        name : str
            Without the dash.
        default : object
            Returned when the option is not set.
        kind : {str, int, float, bool}
        allowed : sequence, optional
            The values allowed.
        text : str
            Help.

        Raises
        ------
        InputError
            When the value has the wrong type or is not allowed.
        """
        self.known[name] = text
        if not self._db.hasName(name):
            return default
        raw = self._db.getString(name, "")
        try:
            if kind is bool:
                value = self._db.getBool(name)
            else:
                value = kind(raw)
        except (ValueError, PETSc.Error):
            raise InputError(f"command line: -{name}: found {raw!r}, allowed: {kind.__name__}") from None
        if allowed is not None and value not in allowed:
            choices = ", ".join(str(a) for a in allowed)
            raise InputError(f"command line: -{name}: found {raw!r}, allowed: {choices}")
        return value

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
            if self._db.hasName(name):
                kept_out[name] = self._db.getString(name, "")
            else:
                # a flag without value is true for PETSc, and the only way to ask for a monitor
                self._db.setValue(name, "" if value is None or value is True or value == "true" else value)
                applied[name] = value
        return applied, kept_out

    def withdraw(self, names):
        """Take options back out of the database."""
        for name in names:
            self._db.delValue(name)

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
        return [name for name in names if name not in ours and not option_used(name)]
