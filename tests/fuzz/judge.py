"""Whether two runs of one scene have the same numbers.

Compared are, at every load step, what is continuous in the data: displacements of all nodes of the file, support
forces, contact forces, largest pressure and penetration, strain energy, plastic strain, displacements of the probes,
forces, moments and motions of total loads, coupled groups, springs, bolts and obstacles, with inertia momentum, its
moment and what became of the energy; each against the largest value
of its kind in the run (or, if that is less, what strains of 1e-6 make).
Forces of the rounding errors that the program itself takes for zero, and their energy, are no difference: where
nothing presses, they are all there is.
Numbers of points are not compared: one whose traction is zero up to rounding errors is open or closed as these have
it.

A solution that is not unique is recognised by the tangent of the solution, without the stabilisation of loose bodies:
its smallest singular value is below `SINGULAR` of its largest entry. From that load step on only the sums of the
forces are compared, and where there is friction, which remembers, nothing is.
"""

from dataclasses import dataclass, field

import numpy as np

# of the largest entry of the tangent: two orders above rounding errors, far below what holds a body by one point
SINGULAR = 1e-9
# strain whose displacement, force and energy are the least to compare with
STRAIN = 1e-6


@dataclass
class Numbers:
    """What a run has to show, in the first scene's axes, units and numbers: arrays over the load steps.

    `turned`: sums of magnitudes in the directions of axes that are no longer those of the first scene. `floors`: what
    rounding errors alone may make of a force and of an energy, by kind, at every load step.
    """

    times: np.ndarray
    values: dict
    turned: tuple = ()
    floors: dict = field(default_factory=dict)

    def at(self, steps):
        """Those of some load steps."""
        values, floors = ({k: v[steps] for k, v in table.items()} for table in (self.values, self.floors))
        return Numbers(self.times[steps], values, self.turned, floors)


def numbers_of(result, variant, first):
    """The numbers of a result in the terms of the first case.

    Parameters
    ----------
    result : dict
        Of worker.py.
    variant : variants.Variant
    first : scenes.Case
    """
    motion, d, case = variant.motion, first.dim, variant.case
    R = np.eye(d) if motion is None else motion.R
    size = d if case.axial or d == 3 else 2
    length, stress = (1.0, 1.0) if motion is None else (motion.length, motion.stress)
    force, energy = stress * length ** (size - 1 if d == 3 or not case.axial else 2), stress * length**size
    if case.axial:
        energy = stress * length**3
    permutes = np.isin(np.abs(R).round(12), (0.0, 1.0)).all()
    moment, sense = force * length, float(np.sign(np.linalg.det(R)))
    rows, turned, floors = [], set(), {"force": [], "moment": [], "energy": []}

    def turn(value, unit):
        # a number in the plane, an axis in space: mirrors turn their sense
        return sense * (np.array(value) @ R if np.ndim(value) else np.array(value)) / unit

    for row in result["steps"]:
        floors["force"].append(row["floor"] / force)
        floors["moment"].append(row["floor"] * case.length / moment)
        floors["energy"].append(row["floor"] * np.linalg.norm(row["u"]) / energy)
        record = row["record"]
        # nodes that the program adds have numbers beyond the file's; those that carry no displacement stay 0
        u = np.zeros((max(len(first.mesh.points), row["nodes"].max() + 1), d))
        u[row["nodes"]] = row["u"]
        u = u[: len(first.mesh.points)] if variant.number is None else u[variant.number]
        for table in case.scene.get("pretensions", []):
            # of a section's two nodes in one place either may have the file's number
            u[np.concatenate([e.nodes.ravel() for e in first.mesh.facets[table["region"]]])] = 0.0
        one = {"u": u @ R / length, "energy": row["energy"] / energy}
        one.update({f"force at {k}": np.array(v) @ R / force for k, v in record["reactions"].items()})
        for name, contact in record["contacts"].items():
            sign = -1.0 if name in variant.swapped else 1.0
            sums = _sums(case, name)
            if sums and not permutes:
                turned.add(f"force {name}")
            one[f"force {name}"] = sign * np.array(contact["force"]) @ (np.abs(R) if sums else R) / force
            one[f"pressure {name}"] = contact["max_pressure"] / stress
            one[f"depth {name}"] = contact["max_penetration"] / length
            if name in variant.swapped:
                # forces act at the points of the other surface
                turned.add(f"moment {name}")
            elif "moment" in contact:
                about = np.zeros(d) if motion is None or _pivots(case, name) else motion.shift
                arm = np.cross(about, contact["force"])
                one[f"moment {name}"] = turn((np.array(contact["moment"]) - arm).tolist(), moment)
        for name, probe in record["probes"].items():
            one[f"probe {name}"] = np.array(probe["mean"]) @ R / length
        for kind in ("loads", "couplings", "springs"):
            for name, table in record.get(kind, {}).items():
                one[f"force of {name} ({kind})"] = np.array(table["force"]) @ R / force
                if "displacement" in table:
                    one[f"probe {name} ({kind})"] = np.array(table["displacement"]) @ R / length
                for key, unit in (("moment", moment), ("rotation", 1.0)):
                    if key in table:
                        one[f"{key} of {name} ({kind})"] = turn(table[key], unit)
        for name, section in record.get("pretensions", {}).items():
            one[f"force of {name}"], one[f"probe {name}"] = section["force"] / force, section["shortening"] / length
        for name, value in record.get("moments", {}).items():
            one[f"moment at {name}"] = turn(value, moment)
        if "released" in record:
            one["force released"] = np.array(record["released"]["force"]) @ R / force
        if "inertia" in record:
            # units of time are the same; moments are about the origin, from where the scene has moved away
            momentum = np.array(record["inertia"]["momentum"])
            one["momentum"] = momentum @ R / force
            if "moment_of_momentum" in record["inertia"]:
                about = np.zeros(d) if motion is None else motion.shift
                own = np.array(record["inertia"]["moment_of_momentum"]) - np.cross(about, momentum)
                one["momentum, moment of"] = turn(own.tolist(), moment)
        sums = record.get("energy", {})
        sums = {**{k: v for k, v in sums.items() if k not in ("contacts", "defect")}, **sums.get("contacts", {})}
        one.update({f"energy {name}": value / energy for name, value in sums.items()})
        one["strain"] = record["plastic"]["max_equivalent_strain"]
        rows.append({key: np.asarray(value) for key, value in one.items()})
    # what does not act in a phase is zero there
    values = {
        key: np.array([row.get(key, np.zeros_like(value)) for row in rows])
        for key, value in {key: value for row in rows for key, value in row.items()}.items()
    }
    times = np.array([row["record"]["time"] for row in result["steps"]])
    floors = {key: np.array(value) for key, value in floors.items()}
    return Numbers(times, values, tuple(turned), floors)


def _pivots(case, name):
    """Whether the moment of a contact is about the pivot of its obstacle, which moves along with the scene."""
    for contact in case.scene.get("contacts", []):
        if contact.get("name") == name and "obstacle" in contact:
            return "angle" in contact["obstacle"] or contact["obstacle"]["shape"] == "mesh"
    return False


def _sums(case, name):
    """Whether a contact's force is a sum of magnitudes, which has no direction."""
    for contact in case.scene.get("contacts", []):
        own = contact.get("name") or ("all" if contact.get("all") else "")
        if own == name and "obstacle" not in contact:
            return bool(contact.get("all")) or contact["source"] == contact.get("target")
    return False


KINDS = ("force", "moment", "pressure", "depth", "probe", "rotation", "u", "energy", "momentum", "momentum,", "strain")


def scales(case, numbers):
    """Largest value of every kind in a run, and what is the least."""
    L, E = case.length, case.stress
    d = 3 if case.axial else case.dim
    forces = E * L ** (d - 1) if d == 3 else E * L
    least = {"force": STRAIN * forces, "moment": STRAIN * forces * L, "rotation": STRAIN,
             "pressure": STRAIN * E, "depth": STRAIN * L, "u": STRAIN * L,
             "energy": STRAIN**2 * forces * L, "strain": STRAIN, "momentum": STRAIN * forces,
             "momentum,": STRAIN * forces * L}  # fmt: skip
    found = dict(least)
    for key, value in numbers.values.items():
        kind = key.split()[0]
        kind = "u" if kind == "probe" else kind
        found[kind] = max(found[kind], float(np.max(np.abs(value), initial=0.0)))
    # a moment is one of forces on arms of the bodies, a rotation one of displacements
    found["moment"] = max(found["moment"], found["force"] * L)
    found["rotation"] = max(found["rotation"], found["u"] / L)
    # energy is a sum of products of the two, which may cancel
    found["energy"] = max(found["energy"], found["force"] * found["u"])
    found["momentum,"] = max(found["momentum,"], found["momentum"] * L)
    # a depth of contact is a part of the displacement, a pressure at least that of the forces
    found["depth"] = max(found["depth"], found["u"])
    return found


def differences(first, second, scale, kinds=KINDS):
    """Largest difference of every number, over the scale of its kind, worst first.

    Parameters
    ----------
    first, second : Numbers
        Of as many load steps.
    scale : dict of str to float
    kinds : sequence of str, optional

    Returns
    -------
    list of (float, str)
    """
    out = []
    for key, value in first.values.items():
        kind = key.split()[0]
        if kind not in kinds or key in second.turned:
            continue
        # what does not act in a phase has no key in a run that has begun after it
        a, b = value, second.values.get(key, None if np.any(value) else value)
        if b is None or a.shape != b.shape or not np.isfinite(b).all():
            out.append((np.inf, key))
            continue
        apart = np.abs(a - b).max(axis=tuple(range(1, a.ndim)), initial=0.0)
        apart -= np.maximum(first.floors.get(kind, 0.0), second.floors.get(kind, 0.0))
        out.append((float(np.max(apart, initial=0.0)) / scale["u" if kind == "probe" else kind], key))
    return sorted(out, reverse=True)
