"""Kinds of residuals, see `pcontact.estimate.estimator`."""

PARTS = ("interior", "jumps", "neumann", "contact", "friction")
INTERIOR, JUMPS, NEUMANN, CONTACT, FRICTION = range(len(PARTS))
