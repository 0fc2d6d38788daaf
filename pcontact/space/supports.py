"""Prescribed displacements: rows of the system that are known beforehand."""

import numpy as np

from pcontact.runtime.parallel import agree


class Supports:
    """Prescribed components of the displacement.

    Parameters
    ----------
    space : Space
    displacements : list of pcontact.scene.model.Displacement
    amplitudes : list of pcontact.scene.amplitude.Amplitude
        Factor of each displacement.
    source : str
        Name of the scene for messages.

    Attributes
    ----------
    which : ndarray (n_local, d)
        Number of the displacement that prescribes the component, -1 where it is free. On the axis of symmetry the
        radial component is held at zero; what no displacement prescribes there has the number after the last.
    regions : list of str
        Region of each displacement.

    Raises
    ------
    InputError
        When two displacements want different values of the same component at the same node, or one wants another
        radial displacement than zero on the axis of symmetry.

    Notes
    -----
    The constructor is *Collective*. Rows and columns of prescribed components are replaced by a multiple
    of the identity and the displacement satisfies them before each solve, so the matrix stays symmetric.
    """

    def __init__(self, space, displacements, amplitudes, source="scene"):
        self._displacements, self._amplitudes = displacements, amplitudes
        self.regions = [d.region for d in displacements]
        self.which = np.full((space.n_local, space.dim), -1, dtype=np.int64)
        self.nodes = []
        message = None
        for number, displacement in enumerate(displacements):
            nodes = space.region(displacement.region)
            self.nodes.append(nodes)
            for axis, value in enumerate(displacement.value):
                if value == "free":
                    continue
                before = self.which[nodes, axis]
                for other in np.unique(before[before >= 0]):
                    if self._differ(number, int(other), axis):
                        at = ", ".join(f"{c:g}" for c in space.points[nodes[before == other][0]])
                        message = message or (
                            f"{source}: displacements[{number}] ({displacement.region}).value: found {value:g} in "
                            f"direction {axis} at the point ({at}), where displacements[{other}] "
                            f"({displacements[other].region}) prescribes {displacements[other].value[axis]:g}; "
                            "allowed: one value (and one amplitude) per point and direction"
                        )
                self.which[nodes, axis] = number
        self._table = np.array(
            [[0.0 if v == "free" else float(v) for v in d.value] for d in displacements] + [[0.0] * space.dim]
        )
        off_axis = self._hold_axis(space, source)
        agree(space.comm, message or off_axis)

    def _hold_axis(self, space, source):
        """Radial displacement zero on the axis of symmetry; returns what is wrong with it, or None. *Collective.*"""
        axis = space.on_axis()
        prescribed = np.unique(self.which[axis, 0])
        self.which[axis & (self.which[:, 0] < 0), 0] = len(self.regions)
        for number in prescribed[prescribed >= 0]:
            if self._table[number, 0] != 0.0:
                return (
                    f"{source}: displacements[{number}] ({self.regions[number]}).value: found "
                    f"{self._table[number, 0]:g} in direction 0 on the axis of symmetry; allowed: 0 or 'free', x is "
                    "the radius"
                )
        return None

    def _differ(self, first, second, axis):
        pair = [(self._displacements[k].value[axis], self._amplitudes[k]) for k in (first, second)]
        times = np.concatenate([amplitude.times for _, amplitude in pair])
        a, b = (value * amplitude.factor(times) for value, amplitude in pair)
        return bool(np.any(a != b))

    @property
    def fixed(self):
        """Flags (n_local, d) of prescribed components."""
        return self.which >= 0

    def values(self, time):
        """Prescribed values (n_local, d) [length] at a time, zero where free."""
        out = np.zeros(self.which.shape)
        for axis in range(out.shape[1]):
            on = self.which[:, axis] >= 0
            number = self.which[on, axis]
            factors = np.array([*(a.factor(time) for a in self._amplitudes), 0.0])
            out[on, axis] = self._table[number, axis] * factors[number]
        return out


