"""Unbiased contact: both surfaces are source and target, half and half (Chouly, Mlika, Renard 2017).

A pair of bodies has two halves: the points of each surface look for partners on the other, and all integrals of a
half, those of the theta terms too, have the weight 1/2. Each half has the tractions, normals, gaps and the gamma of its
own source; forces balance since every half acts on the jump. Self contact has one half: all points of the surface look
for partners on it, so that both of two places that touch have theirs.

Where the traction of a half is that of its source, the residual is monotone for gamma > (1 + theta)^2 / 8 times the
constant of the trace inequality, half of what contact with a source and a target needs; the default gamma0 is half as
large, too. Where it is the weighted one of both sides, both halves use the energy of both bodies, and nothing changes.

Each half is a :class:`pcontact.contact.pair.ContactPair` of its own; `pcontact.contact.report` makes one of their
reports.
"""

from dataclasses import replace

from pcontact.contact.formulation.parameters import parameter

WEIGHT = 0.5


def is_unbiased(contact):
    """Whether a contact is made of halves: it says so, or it is self contact."""
    return contact.unbiased or contact.target == contact.source


def halved(source):
    """A source surface (SourceSurface) whose quadrature weights are halved, and with them all terms."""
    return replace(source, jxw=WEIGHT * source.jxw)


def contacts_of_halves(contact, both):
    """The contacts (one or two) that make up an unbiased one: from each surface to the other.

    Parameters
    ----------
    contact : pcontact.scene.model.Contact
        With its numerics resolved.
    both : bool
        Whether the traction of a half is that of both sides.
    """
    gamma0 = contact.gamma0
    if gamma0 is None and not both and contact.formulation in (None, "nitsche"):
        gamma0 = WEIGHT * parameter(contact)
    forth = replace(contact, gamma0=gamma0)
    if contact.source == contact.target:
        return [forth]
    return [forth, replace(forth, source=contact.target, target=contact.source)]
