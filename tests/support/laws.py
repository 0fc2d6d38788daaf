"""Laws of friction in plain numpy."""

import numpy as np

from pcontact.contact.law import OPEN, SLIP, STICK, contact_law
from pcontact.scene.model import Contact

# keys of a contact, for tractions of about 1
LAWS = {
    "coulomb": {"friction": 0.3},
    "steep": {"friction": 1.5},
    "limit": {"friction": 0.3, "friction_limit": 0.4},
    "adhesion": {"friction": 0.3, "adhesion": 0.2},
    "all": {"friction": 0.3, "friction_limit": 0.5, "adhesion": 0.2},
    "tresca": {"tresca": 0.6},
}


def law_of(name):
    """The row of numbers of a law."""
    return contact_law(Contact("a", "b", **LAWS[name])).row


def limit_of(name):
    """Largest tangential traction."""
    return LAWS[name].get("friction_limit", LAWS[name].get("tresca", np.inf))


def numpy_projection(name, bilateral, normal, tau):
    """P, D, status as they stand in FORMULATION 1.2 and 1.4."""
    keys = LAWS[name]
    nn = np.outer(normal, normal)
    across = np.eye(len(normal)) - nn
    tau_n, tau_t = tau @ normal, across @ tau
    closed = bilateral or tau_n <= 0.0
    if "tresca" in keys:
        rho, growth = keys["tresca"], 0.0
    else:
        free = keys.get("adhesion", 0.0) - keys["friction"] * tau_n
        rho = min(max(free, 0.0), limit_of(name))
        growth = keys["friction"] if 0.0 <= free <= limit_of(name) else 0.0
    if not closed and rho == 0.0:
        return np.zeros_like(tau), np.zeros_like(nn), OPEN
    push, h = (tau_n * normal, nn) if closed else (np.zeros_like(tau), np.zeros_like(nn))
    length = np.linalg.norm(tau_t)
    if length <= rho:
        return push + tau_t, h + across, STICK
    s = tau_t / length
    d = h + rho / length * (across - np.outer(s, s)) - growth * np.outer(s, normal)
    return push + rho * s, d, SLIP
