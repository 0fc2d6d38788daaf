"""Which degree reaches the target with less work, from a pass of either on the same mesh."""

from typing import NamedTuple

from pcontact.runtime import log


def work(done, error):
    """Entries of the tangent that a target takes, if the error of the mesh falls as fast as the degree lets it.

    Parameters
    ----------
    done : pcontact.adapt.passes.Pass
    error : float
        To be reached.

    Returns
    -------
    float
    """
    rate = done.power * done.degree / done.known.dim
    # without margins, which the change from one degree to the other makes large
    return done.entries * max(done.expected / error, 1.0) ** (1.0 / rate)


def cheaper(lower, higher, error):
    """The choice between two passes on the same mesh.

    Refined meshes have the rate of the degree where the solution is singular, too: what counts is what an entry of the
    tangent costs, once.

    Parameters
    ----------
    lower, higher : pcontact.adapt.passes.Pass
        Of degree 1 and 2.
    error : float

    Returns
    -------
    dict
        ``degree``, ``why``, and ``entries`` that each is expected to take.
    """
    entries = {1: work(lower, error), 2: work(higher, error)}
    degree = min(entries, key=entries.get)
    why = (f"an error of {100.0 * error:.3g} % takes about {entries[1]:.2g} entries of the tangent with degree 1, "
           f"{entries[2]:.2g} with degree 2")  # fmt: skip
    return {"degree": degree, "why": why, "entries": {str(k): value for k, value in entries.items()}}


class Tried(NamedTuple):
    """A pass from which the loop can go on.

    Attributes
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    watch : pcontact.adapt.watch.Watch
    done : pcontact.adapt.passes.Pass
    plan : callable
        ``plan(most)``: how its cells are to be cut, with a growth of their number at most.
    step : object
        How they are with the growth that the budget is expected to allow.
    """

    mesh: object
    watch: object
    done: object
    plan: object
    step: object


class Degree:
    """The degree of the displacement in the passes: the user's, or chosen on the first mesh.

    Parameters
    ----------
    given : int or None
        The user's.

    Attributes
    ----------
    now : int or None
        Of the next pass; None: 1, and then 2.
    chosen : dict or None
        See :func:`cheaper`; without ``entries`` where there was no choice.
    """

    def __init__(self, given):
        self.now, self.chosen, self._lower = given, None, None

    @property
    def is_open(self):
        """Whether the degree is ours to choose, and none but 1 has been tried."""
        return self.now is None and self.chosen is None and self._lower is None

    def take(self, degree, why):
        """Choose a degree without trials, and return it."""
        self.now, self.chosen = degree, {"degree": degree, "why": why}
        log.info("degree %d: %s", degree, why)
        return degree

    def try_higher(self, lower):
        """Keep the pass of degree 1, and let the next one on its mesh have degree 2."""
        self._lower, self.now = lower, 2

    def choose(self, last, error):
        """The pass from which to go on: of those of both degrees, where the last one was the second of them.

        Parameters
        ----------
        last : Tried
        error : float
            To be reached.

        Returns
        -------
        Tried
        """
        if self._lower is None:
            return last
        lower, self._lower = self._lower, None
        self.chosen = cheaper(lower.done, last.done, error)
        log.info("degree %d: %s", self.chosen["degree"], self.chosen["why"])
        if self.chosen["degree"] == 2:
            return last
        self.now = 1
        return lower
