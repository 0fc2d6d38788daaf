"""Bodies with inertia: known answers of impacts, waves and friction that stops a body.

* ``bar``: a bar (length 10, E 900, rho 1, waves at 30) hits a wall with the velocity 10. Contact from 0.5 to 7/6, force
  300 throughout, and it leaves as a whole with 10. By integrator and theta, on 100 cells at a Courant number of 0.5.
* ``bounce``: the same bar falls from rest (g 10): where its foot is at 2, 2.5, 3, and how high its middle comes after
  each bounce (it rests, undeformed, after every second one). Waves that come back later than those of other lengths are
  what a bounce lacks: at a Courant number of sqrt(1/2) the consistent mass makes them as fast as the integrator slow.
* ``string``: E = rho = L = 1, held at x = 1, let go from u = (1 - x)/2 above a wall that it hits in every period of 3:
  the energy 1/8 for ever, the force 1/2 in contact.
* ``held``: a bar whose sides are held (code_aster SDNV100: L 0.2, side 0.02, E 2e11, rho 8000, gap 2e-3, velocity 100);
  pressure rho c v of the constrained wave, contact for 2 L / c.
* ``hertz``: steel balls (R 0.01, E 210e9, nu 0.3, rho 7800), 1 m/s: one on a rigid wall, two against each other.
  Largest force and duration of Hertz' quasi-static theory.
* ``elastic``: an elastic bar (r 3.2, l 32.4 mm, E 117 GPa, nu 0.35, rho 8930) hits a rigid wall at 227 m/s: the energy
  of 239.8 J is there afterwards.
* ``taylor``: the same bar of copper (yield stress 0.4, hardening 0.1 GPa), finite strain: length and radius at 80 us.
* ``slider``: a block that rests on a plane gets a velocity: it stops after v^2 / (2 mu g).

What is missing in the balance of energy, and what integrator and contact have taken, stands beside each.
"""

import numpy as np

from drivers._common import log, main, make_mesh
from drivers.cases._known import Found, at, case_parser, compare, solve
from meshes import balls, cylinder_strip, one_block
from pcontact.scene.model import (
    Body,
    Contact,
    Displacement,
    Dynamics,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Phase,
    Scene,
    Steps,
)

CASES = ("bar", "bounce", "string", "held", "hertz", "elastic", "taylor", "slider")
# energy after the impact over that before, by integrator and theta, of an independent code with 100 cells
TABLE = {("hht", 0.0): 0.9998, ("trapezoidal", 0.0): 1.015, ("trapezoidal", 1.0): 1.0, ("hht", 1.0): 0.993,
         ("euler", 0.0): 0.875}  # fmt: skip
BOUNDS = {"bar": 0.01, "bounce": 0.01, "string": 0.04, "held": 0.02, "hertz": 0.02, "elastic": 0.005, "taylor": 0.02,
          "slider": 2e-3}  # fmt: skip
FEET = {2.0: 1.6667, 2.5: 4.0278, 3.0: 4.4444}
# ends of the contacts, beginnings of the next ones, and how high the middle is between them
BOUNCES = ((5.0 / 3.0, 11.0 / 3.0, 9.25926), (13.0 / 3.0, 19.0 / 3.0, 10.0), (7.0, 9.0, 9.25926))
ALWAYS = [(0, 1), (1, 1)]


def wall(source, theta=None, radius=None):
    """A rigid wall below y = 0."""
    floor = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0])
    return Contact(source, obstacle=floor, name="wall", theta=theta, search_radius=radius)


def column(records, *keys):
    """Numbers (n,) of load steps under some keys."""
    values = records
    for key in keys:
        values = [one[key] for one in values]
    return np.array(values)


def balance(name, records):
    """Log what became of the energy."""
    energy, worst = records[-1]["energy"], np.abs(column(records, "energy", "defect")).max()
    start = max(energy["initial"], energy["loads"])
    lost = sum(energy.get("contacts", {}).values())
    log.info("  %s: of the initial energy kinetic %.5f, stored %.5f, integrator %.5f, contacts %.5f; defect %.1e", name,
             energy["kinetic"] / start, energy["stored"] / start, energy["numerical"] / start, lost / start, worst)


def mechanical(record):
    """Kinetic and elastic energy."""
    return record["energy"]["kinetic"] + record["energy"]["stored"]


def fall(args, petsc, end, gravity=0.0, theta=0.0, integrator="hht", courant=0.5):
    """The bar of length 10 above the wall."""
    n = 10 if args.tiny else args.n or 100
    path = make_mesh(one_block, args.o / "bar.msh", 2, (1, n), size=(1.0, 10.0), lower=(0.0, 5.0))
    sides = [Displacement(side, [0.0, "free"]) for side in ("left", "right")]
    loads = [Load("block", acceleration=[0.0, -gravity], amplitude=ALWAYS)] if gravity else []
    scene = Scene(
        title="A bar on a wall", mesh=MeshSpec(path), materials={"m": Material(900.0, 0.0, density=1.0)},
        bodies=[Body("block", "m", initial_velocity=[0.0, 0.0 if gravity else -10.0])],
        contacts=[wall("bottom", theta, 2.0)], displacements=sides, loads=loads,
        steps=Steps(end, round(end * 30.0 * n / 10.0 / courant)), output=Output(fields=False, probes=["bottom"]),
        dynamics=Dynamics(integrator=integrator), petsc=petsc,
    )  # fmt: skip
    return solve(args, "bar", scene)


def bar(args, petsc):
    """The table of integrators."""
    rows, every, good, norms = [], [], True, []
    for (integrator, theta), expected in list(TABLE.items())[: 1 if args.tiny else None]:
        records, converged, norms = fall(args, petsc, 1.4, theta=theta, integrator=integrator)
        name, good = f"{integrator}, theta {theta:g}", good and converged
        time, force = column(records, "time"), -column(records, "contacts", "wall", "force")[:, 1]
        inside = (time > 0.55) & (time < 1.1)
        rows.append((f"{name}: energy", expected, mechanical(records[-1]) / 500.0))
        rows.append((f"{name}: mean force", 300.0, float(force[inside].mean())))
        rows.append((f"{name}: end of contact", 7.0 / 6.0, float(time[force > 0.0][-1])))
        log.info("  %s: mean error of the force %.3g", name, np.abs(force[inside] - 300.0).mean())
        balance(name, records)
        every += records
    return Found(rows, every, good, norms)


def bounce(args, petsc):
    """The bar falls from rest, four times."""
    records, converged, norms = fall(args, petsc, 1.2 if args.tiny else 9.0, gravity=10.0, courant=np.sqrt(0.5))
    foot = 5.0 + column(records, "probes", "bottom", "mean")[:, 1]
    time, middle = column(records, "time"), 10.0 - column(records, "energy", "loads") / 100.0
    rows = [(f"foot at {t:g}", place, float(np.interp(t, time, foot))) for t, place in FEET.items() if t < time[-1]]
    for number, (begin, end, height) in enumerate(BOUNCES, 1):
        inside = (time > begin) & (time < end)
        if time[-1] >= end - 0.01:
            rows.append((f"height of bounce {number}", height, float(middle[inside].max())))
    balance("bounce", records)
    return Found(rows, records, converged, norms)


def string(args, petsc):
    """A bar that hits the wall for ever."""
    n, periods = (10, 1) if args.tiny else (args.n or 50, 10)
    path, rows, every, good, norms = make_mesh(one_block, args.o / "string.msh", 2, (1, n)), [], [], True, []
    held = [Displacement(side, [0.0, "free"]) for side in ("left", "right")] + [Displacement("top", [0.0, 0.0])]
    for integrator in ("trapezoidal", "hht")[: 1 if args.tiny else None]:
        scene = Scene(
            title="A bar that hits a wall for ever", mesh=MeshSpec(path),
            materials={"m": Material(1.0, 0.0, density=1.0)},
            bodies=[Body("block", "m", initial_displacement=[0.0, "(1 - y)/2"])], contacts=[wall("bottom", 1.0, 2.0)],
            displacements=held, steps=Steps(3.0 * periods, 6 * n * periods), output=Output(fields=False),
            dynamics=Dynamics(integrator=integrator), petsc=petsc,
        )  # fmt: skip
        records, converged, norms = solve(args, "string", scene)
        good, every = good and converged, every + records
        time, force = column(records, "time"), -column(records, "contacts", "wall", "force")[:, 1]
        inside = (time % 3.0 > 1.1) & (time % 3.0 < 1.9)
        rows.append((f"{integrator}: force", 0.5, float(force[inside].mean())))
        for period in {1, periods}:
            # what integrators of second order dissipate is told, not bounded
            expected = 0.125 if integrator == "trapezoidal" else np.nan
            found = mechanical(at(records, 3.0 * period - 0.02))
            rows.append((f"{integrator}: energy after {period}", expected, found))
        balance(integrator, records)
    return Found(rows, every, good, norms)


def held(args, petsc):
    """The bar whose sides are held: a wave of one dimension, with Poisson's effect in its modulus."""
    n, rows, every, good, norms = 10 if args.tiny else args.n or 100, [], [], True, []
    path = make_mesh(one_block, args.o / "held.msh", 2, (1, n), size=(0.02, 0.2), lower=(0.0, 2e-3))
    for nu in (0.0, 0.3):
        modulus = 2e11 * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))
        speed = np.sqrt(modulus / 8000.0)
        end = 2e-5 + 0.4 / speed
        scene = Scene(
            title="A bar with held sides", mesh=MeshSpec(path), materials={"m": Material(2e11, nu, density=8000.0)},
            bodies=[Body("block", "m", initial_velocity=[0.0, -100.0])], contacts=[wall("bottom", None, 0.02)],
            displacements=[Displacement(side, [0.0, "free"]) for side in ("left", "right")],
            steps=Steps(1.15 * end, round(1.15 * end * speed * n / 0.1)), output=Output(fields=False),
            dynamics=Dynamics(), petsc=petsc,
        )  # fmt: skip
        records, converged, norms = solve(args, "held", scene)
        good, every = good and converged, every + records
        time, force = column(records, "time"), -column(records, "contacts", "wall", "force")[:, 1]
        inside, touched = (time > 2e-5 + 0.05 * end) & (time < 0.9 * end), time[force > 0.0]
        rows.append((f"nu {nu:g}: pressure", 8000.0 * speed * 100.0, float(force[inside].mean() / 0.02)))
        rows.append((f"nu {nu:g}: release", end, float(touched[-1])))
        # per unit thickness of a bar 0.02 thick
        rows.append((f"nu {nu:g}: energy", 3200.0, 0.02 * mechanical(records[-1])))
        balance(f"nu {nu:g}", records)
    return Found(rows, every, good, norms)


def hertz(args, petsc):
    """Balls: largest force and duration of quasi-static contact."""
    radius, rho, modulus = 0.01, 7800.0, 210e9 / (1.0 - 0.3**2)
    mass, rows, every, good, norms = rho * 4.0 / 3.0 * np.pi * radius**3, [], [], True, []
    for name, two, force, duration in (("wall", False, 2300.9, 52.24e-6), ("two", True, 1001.5, 60.01e-6)):
        # radius of the contact
        effective, curved = (0.5 * modulus, 0.5 * radius) if two else (modulus, radius)
        wide = (0.75 * force * curved / effective) ** (1.0 / 3.0)
        path = make_mesh(balls, args.o / f"{name}.msh", radius, wide / (2.0 if args.tiny else args.n or 10), two=two)
        pair = Contact("upper_skin", "lower_skin", name="wall") if two else wall("upper_skin")
        pair.search_radius = 0.2 * radius
        steel, speed = Material(210e9, 0.3, density=rho), 0.5 if two else 1.0
        bodies = [Body("upper", "steel", initial_velocity=[0.0, -speed])]
        bodies += [Body("lower", "steel", initial_velocity=[0.0, speed])] if two else []
        scene = Scene(
            title="Hertz' impact", mesh=MeshSpec(path, order=2, kinematics="axisymmetric"), materials={"steel": steel},
            bodies=bodies, contacts=[pair], displacements=[Displacement("axis", [0.0, "free"])],
            steps=Steps(1.2 * duration, 12 if args.tiny else 200), output=Output(fields=False), dynamics=Dynamics(),
            petsc=petsc,
        )  # fmt: skip
        records, converged, norms = solve(args, name, scene)
        good, every = good and converged, every + records
        time, pressed = column(records, "time"), np.abs(column(records, "contacts", "wall", "force")[:, 1])
        rows.append((f"{name}: largest force", force, float(pressed.max())))
        rows.append((f"{name}: duration", duration, float(time[pressed > 0.0][-1] + 0.5 * time[0])))
        momentum = 0.0 if two else mass * speed
        rows.append((f"{name}: momentum", momentum or np.nan, records[-1]["inertia"]["momentum"][1]))
        balance(name, records)
    return Found(rows, every, good, norms)


def copper(args, petsc, title, material, strain, count, cells, integrator="hht"):
    """A round bar that hits a rigid wall at 227 m/s; mm, ms, g, so that stresses are in MPa and energies in mJ."""
    name = title.split()[0].lower()
    path = make_mesh(cylinder_strip, args.o / f"{name}.msh", cells, inner=0.0, outer=3.2, height=32.4)
    scene = Scene(
        title=title, mesh=MeshSpec(path, kinematics="axisymmetric", strain=strain, mean_dilatation=True),
        materials={"m": material}, bodies=[Body("body", "m", initial_velocity=[0.0, -227.0])],
        contacts=[wall("bottom", None, 3.0)], displacements=[Displacement("inner", [0.0, "free"])],
        steps=Steps(0.01 if args.tiny else 0.08, count), output=Output(fields=False, probes=["top", "outer"]),
        dynamics=Dynamics(integrator=integrator), petsc=petsc,
    )  # fmt: skip
    return solve(args, name, scene)


def elastic(args, petsc):
    """What an elastic bar does with its energy."""
    cells = (2, 20) if args.tiny else (6, 60)
    material = Material(117e3, 0.35, density=8.93e-3)
    rows, every, good, norms = [], [], True, []
    for integrator in ("trapezoidal", "hht")[: 1 if args.tiny else None]:
        count = 20 if args.tiny else 600
        records, converged, norms = copper(args, petsc, "Elastic bar", material, "small", count, cells, integrator)
        balance(integrator, records)
        good, every = good and converged, every + records
        # what integrators dissipate is told, not bounded
        after = 239.8 if integrator == "trapezoidal" else np.nan
        rows.append((f"{integrator}: energy before [J]", 239.8, 1e-3 * records[-1]["energy"]["initial"]))
        rows.append((f"{integrator}: energy after [J]", after, 1e-3 * mechanical(records[-1])))
    return Found(rows, every, good, norms)


def taylor(args, petsc):
    """Taylor's bar of copper."""
    cells = (2, 20) if args.tiny else (4, 50)
    material = Material(117e3, 0.35, yield_stress=400.0, hardening=100.0, density=8.93e-3)
    records, converged, norms = copper(args, petsc, "Taylor bar", material, "finite", 20 if args.tiny else 400, cells)
    balance("taylor", records)
    probes = records[-1]["probes"]
    length, radius = 32.4 + probes["top"]["mean"][1], 3.2 + probes["outer"]["max"][0]
    # an independent code with the same cells
    rows = [("length", 21.515, length), ("radius", 7.223, radius)]
    log.info("  largest plastic strain %.3g, plastic work %.4g J", records[-1]["plastic"]["max_equivalent_strain"],
             1e-3 * records[-1]["energy"]["plastic"])  # fmt: skip
    return Found(rows, records, converged, norms)


def slider(args, petsc):
    """A block that friction stops."""
    path, friction, gravity = make_mesh(one_block, args.o / "slider.msh", 2, 2), 0.3, 10.0
    floor = wall("bottom")
    floor.friction = friction
    scene = Scene(
        title="A block that slides", mesh=MeshSpec(path), materials={"m": Material(1e5, 0.3, density=1.0)},
        bodies=[Body("block", "m", initial_velocity=[1.0, 0.0])], contacts=[floor],
        loads=[Load("block", acceleration=[0.0, -gravity])],
        phases=[Phase("rest"), Phase("slide", 0.36, 20 if args.tiny else 1400)],
        output=Output(fields=False, probes=["bottom"]), dynamics=Dynamics(phases=["slide"]), petsc=petsc,
    )  # fmt: skip
    records, converged, norms = solve(args, "slider", scene)
    energy = records[-1]["energy"]
    rows = [("way", 1.0 / (2.0 * friction * gravity), records[-1]["probes"]["bottom"]["mean"][0]),
            ("dissipated", 0.5, energy["contacts"]["wall"])]  # fmt: skip
    balance("slider", records)
    return Found(rows, records, converged, norms)


MAKERS = {"bar": bar, "bounce": bounce, "string": string, "held": held, "hertz": hertz, "elastic": elastic,
          "taylor": taylor, "slider": slider}  # fmt: skip


def run(args):
    """All cases asked for; 1 where one does not converge or misses a known answer."""
    return compare(args, MAKERS, BOUNDS, "impact", {})


if __name__ == "__main__":
    main(run, case_parser(__doc__, "impact", CASES))
