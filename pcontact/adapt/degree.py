"""The degree of the displacement in the passes: the user's, or chosen after a pass of degree 1 on the first mesh."""

from pcontact.runtime import log

# [-] By dimension: entries of the tangent of degree 2 over those of degree 1 on the same simplices. From: nodes in the
# middles of edges, 3 and 7 a vertex, and the mean number of neighbours of each.
ENTRIES = {2: 6.6, 3: 15.0}


class Degree:
    """The degree.

    Parameters
    ----------
    given : int or None
        The user's.

    Attributes
    ----------
    now : int or None
        Of the next pass; None: 1, and it is to be chosen then.
    chosen : dict or None
        For the report: ``degree`` and ``why``.
    """

    def __init__(self, given):
        self.now, self.chosen = given, None

    @property
    def is_open(self):
        """Whether the degree is still to be chosen."""
        return self.now is None

    def take(self, degree, why):
        """Choose a degree, and return it."""
        self.now, self.chosen = degree, {"degree": degree, "why": why}
        log.info("degree %d: %s", degree, why)
        return degree

    def choose(self, done, error, most):
        """Choose by a pass of degree 1 that has missed an error: 2, unless finer cells of degree 1 reach it with fewer
        entries of the tangent than degree 2 takes on the same mesh, or there is no room.

        Parameters
        ----------
        done : pcontact.adapt.passes.Pass
        error : float
        most : float
            Growth of the unknowns that the budget allows.

        Returns
        -------
        int
        """
        dim = done.known.dim
        growth = max(done.expected / error, 1.0) ** (dim / done.power)
        if 2.0**dim > most:
            unknowns = 2.0**dim * done.unknowns
            return self.take(1, f"the budget does not allow {unknowns:.2g} unknowns of degree 2")
        words = f"{growth:.2g} times the entries of the tangent for an error of {100.0 * error:.3g} %"
        if growth < ENTRIES[dim]:
            return self.take(1, f"finer cells take {words}, degree 2 {ENTRIES[dim]:g} times on the same mesh")
        return self.take(2, f"degree 1 takes {words}, and more than degree 2 where that is much")
