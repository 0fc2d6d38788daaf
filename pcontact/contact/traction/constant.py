"""The traction of a source that has one more part, which does not depend on the displacement."""

from pcontact.contact.traction.elastic import ElasticTraction


class ConstantTraction(ElasticTraction):
    """A traction with another one added.

    Parameters
    ----------
    rest : ElasticTraction
        The traction without.
    trace : object
        Its ``tractions(rest)`` (np, d) is what is added [stress].
    """

    def __init__(self, rest, trace):
        super().__init__(rest.source)
        self._rest, self._trace = rest, trace
        self.consistent, self.symmetric, self.jumps = rest.consistent, rest.symmetric, rest.jumps

    def linear(self, values, p, wanted):
        """See :meth:`ElasticTraction.linear`."""
        return self._rest.linear(values, p, wanted)

    def add_excess(self, values, p, traction):
        """See :meth:`ElasticTraction.add_excess`."""
        self._rest.add_excess(values, p, traction)
        traction += self._trace.tractions(self._rest)

    def add_normal_excess(self, values, p, traction):
        """See :meth:`ElasticTraction.add_normal_excess`."""
        self._rest.add_normal_excess(values, p, traction)
        traction += (self._trace.tractions(self._rest) * p.normal).sum(axis=1)

    def excess(self, values, p):
        """See :meth:`ElasticTraction.excess`."""
        return self._rest.excess(values, p)

    def add_adjoint(self, values, p, weights, out):
        """See :meth:`ElasticTraction.add_adjoint`."""
        self._rest.add_adjoint(values, p, weights, out)

    def add_curvature(self, values, p, weights, blocks):
        """See :meth:`ElasticTraction.add_curvature`."""
        return self._rest.add_curvature(values, p, weights, blocks)
