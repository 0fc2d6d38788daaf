"""Laws of materials that tests add: von Mises plasticity anew, elasticity of Ramberg and Osgood, creep of Norton."""

import numpy as np

from pcontact.material.elastic import lame
from pcontact.material.laws import ADDED, PointLaw, add_material

ONE = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
DEVIATOR = np.eye(6) - np.outer(ONE, ONE) / 3.0


def along(vectors):
    """Norms (n,) and directions (n, 6)."""
    norm = np.linalg.norm(vectors, axis=1)
    return norm, vectors / np.where(norm > 0.0, norm, 1.0)[:, None]


def isochoric(lam, mu, strain, deviator, share, slope, direction):
    """Stress and tangent of a deviator (n, 6), share times 2 mu of the trial strain's deviator, with its slope along a
    direction."""
    bulk = lam + 2.0 / 3.0 * mu
    stress = bulk * (strain @ ONE)[:, None] * ONE + deviator
    tangent = bulk * np.outer(ONE, ONE) + 2.0 * mu * (
        share[:, None, None] * DEVIATOR + (slope - share)[:, None, None] * np.einsum("ni,nj->nij", direction, direction)
    )
    return stress, tangent


class Mises(PointLaw):
    """Linear isotropic hardening; parameters are yield stress and hardening."""

    width = 7

    def respond(self, strain, state, step, temperature):
        (lam, mu), (limit, hardening) = lame(self.material.E, self.material.nu), self.material.parameters
        trial = 2.0 * mu * (strain @ DEVIATOR - state[:, :6])
        norm, direction = along(trial)
        beyond = np.sqrt(1.5) * norm - (limit + hardening * state[:, 6])
        flow = np.maximum(beyond, 0.0) / (3.0 * mu + hardening)
        share = 1.0 - 3.0 * mu * flow / np.where(flow > 0.0, np.sqrt(1.5) * norm, 1.0)
        slope = np.where(flow > 0.0, hardening / (3.0 * mu + hardening), 1.0)
        new = np.column_stack([state[:, :6] + np.sqrt(1.5) * flow[:, None] * direction, state[:, 6] + flow])
        return *isochoric(lam, mu, strain, share[:, None] * trial, share, slope, direction), new

    def plastic_strain(self, state):
        return state[..., 6]

    def energy(self, strain, state):
        (lam, mu), (limit, hardening) = lame(self.material.E, self.material.nu), self.material.parameters
        elastic, p = strain - state[:, :6], state[:, 6]
        stored = 0.5 * lam * (elastic @ ONE) ** 2 + mu * np.sum(elastic**2, axis=1)
        return stored, limit * p + 0.5 * hardening * p**2


class RambergOsgood(PointLaw):
    """eps = sigma / E (1 + alpha (sigma / s)^(n - 1)) in a uniaxial test, elastic; parameters alpha, s, n."""

    def _root(self, strain):
        """Equivalent stress of equivalent strains (n,), and d strain / d stress there."""
        (_, mu), (alpha, s, n) = lame(self.material.E, self.material.nu), self.material.parameters
        young = self.material.E
        factor, q = alpha / young, np.minimum(3.0 * mu * strain, s * (strain * young / s) ** (1.0 / n))
        for _ in range(60):
            power = (q / s) ** (n - 1.0)
            slope = 1.0 / (3.0 * mu) + n * factor * power
            q = q - (q / (3.0 * mu) + factor * q * power - strain) / slope
        return q, slope

    def respond(self, strain, state, step, temperature):
        lam, mu = lame(self.material.E, self.material.nu)
        norm, direction = along(strain @ DEVIATOR)
        equivalent = np.sqrt(2.0 / 3.0) * norm
        q, slope = self._root(equivalent)
        share = np.where(norm > 0.0, q / np.where(norm > 0.0, 3.0 * mu * equivalent, 1.0), 1.0)
        deviator = 2.0 * mu * share[:, None] * (strain @ DEVIATOR)
        return *isochoric(lam, mu, strain, deviator, share, 1.0 / (3.0 * mu * slope), direction), state

    def energy(self, strain, state):
        (lam, mu), (alpha, s, n) = lame(self.material.E, self.material.nu), self.material.parameters
        strains = np.sqrt(2.0 / 3.0) * along(strain @ DEVIATOR)[0]
        q, _ = self._root(strains)
        other = q**2 / (6.0 * mu) + alpha / self.material.E * q**2 * (q / s) ** (n - 1.0) / (n + 1.0)
        return 0.5 * (lam + 2.0 / 3.0 * mu) * (strain @ ONE) ** 2 + q * strains - other, np.zeros(len(strain))


class Norton(PointLaw):
    """Creep rate A exp(c T) sigma^n of the equivalent stress; parameters A, n, c. The state is the creep strain."""

    width = 6

    def respond(self, strain, state, step, temperature):
        (lam, mu), (rate, n, c) = lame(self.material.E, self.material.nu), self.material.parameters
        trial = 2.0 * mu * (strain @ DEVIATOR - state)
        norm, direction = along(trial)
        equivalent, speed = np.sqrt(1.5) * norm, 3.0 * mu * step * rate * np.exp(c * temperature)
        q = equivalent.copy()
        for _ in range(60):
            # from above, and convex: Newton's method falls to the root
            q = q - (q + speed * q**n - equivalent) / (1.0 + speed * n * q ** (n - 1.0))
        slope = 1.0 / (1.0 + speed * n * q ** (n - 1.0))
        share = np.where(norm > 0.0, q / np.where(norm > 0.0, equivalent, 1.0), 1.0)
        new = state + (1.0 - share)[:, None] * trial / (2.0 * mu)
        return *isochoric(lam, mu, strain, share[:, None] * trial, share, slope, direction), new


ALL = {"mises": Mises, "ramberg_osgood": RambergOsgood, "norton": Norton}


def add_all():
    """Add all of them."""
    for name, law in ALL.items():
        add_material(name, law)


def remove_all():
    """Take them away again."""
    for name in ALL:
        ADDED.pop(name, None)
