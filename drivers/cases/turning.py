"""Bodies that turn on each other with friction, at finite strain: moments against those that friction can bear.

* ``hemisphere``: a hollow hemisphere (radii 1, 0.5; E 5) is pressed by 1 into a cube of side 2 (E 1), then turned by 90
  degrees; neo-Hooke, nu 0.3, friction 0.5. R. A. Sauer and L. De Lorenzis (2015) do not say their inner radius: here
  force and moment are compared under refinement, and the moment with its bound, the integral of mu p r over the
  surface as it is deformed, which is reached where all points slip around the axis.
* ``torque``: a thin square pad (side 1, nu 0, E 1e4) under a pressure of 1 is turned by 90 degrees on a rigid plane.
  Moment: mu N times the mean distance of a square's points from its middle, 0.3825979. Friction acts along the chord
  of a load step's way: of the moment 1 - cos(half the angle of a load step) is missing.
* ``disk``: the same of a round pad of radius 1, a polygon of 48 sides: 2/3 mu N R, less 0.14 % for the polygon.
* ``pad``: a soft square pad presses on a ring that turns by 90 degrees below it and drags it. The moment of the ring's
  support against the bound above, and against mu N times the mean distance of the pad's points from the axis.

Newton's iterations per load step, load steps that were cut and the last residuals are printed. ``--linear`` also solves
the bonded linear elastic problem on the mesh of the hemisphere, and says how many of its solves a load step takes.
"""

import time

import numpy as np

from drivers._common import draw, log, main, make_mesh, picture, print_table, running
from drivers.cases._known import Found, Rows, case_parser, compare
from meshes import disk, hemisphere_on_cube, one_block, pad_on_ring
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Scene, Steps

CASES = ("hemisphere", "torque", "disk", "pad")
INNER, DEPTH, ANGLE = 0.5, 1.0, 90.0
SQUARE = 0.3825979  # mean distance of a unit square's points from its middle
# of the square pad: what a thicker one bends is not small beside its pressure
THICKNESS = 0.05
# what may be missing, by case: of the hemisphere points still stick, or slip across the way around the axis
BOUNDS = {"hemisphere": 0.1, "torque": 4e-3, "disk": 4e-3, "pad": 0.01}


def turned(region, angle, time):
    """A support that turns about the z-axis after time[0] until time[1], free along it."""
    return Displacement(region, [0.0, 0.0, "free"], [(0.0, 0.0), (time[0], 0.0), (time[1], 1.0)], angle=angle,
                        point=[0.0] * 3, axis=[0.0, 0.0, 1.0])  # fmt: skip


def lowered(region, depth, time, sides="free"):
    """A support that goes down by a depth until a time."""
    amplitude = [(0.0, 0.0), (time[0], 1.0), (time[1], 1.0)]
    return Displacement(region, [sides, sides, -depth], amplitude)


def hemisphere_scene(path, press, turn, depth=DEPTH, angle=ANGLE, **more):
    """The hemisphere on the cube: load steps that press, and that turn."""
    times = (float(press), float(press + turn))
    return Scene(
        title="A hemisphere turns on a cube",
        mesh=MeshSpec(path, strain="finite"),
        materials={"stiff": Material(5.0, 0.3, law="neo_hooke"), "soft": Material(1.0, 0.3, law="neo_hooke")},
        bodies=[Body("hemisphere", "stiff"), Body("cube", "soft")],
        contacts=[Contact("cube_top", "hemisphere_skin", name="sole", friction=0.5, search="ray_tracing")],
        displacements=[
            Displacement("cube_bottom", [0.0] * 3),
            lowered("hemisphere_top", depth, times),
            turned("hemisphere_top", angle, times),
        ],
        steps=Steps(end=times[1], count=press + turn),
        **more,
    )


def torque_scene(path, press, turn, angle=ANGLE, body="block", middle=0.5, **more):
    """A pad on a rigid plane that turns about (middle, middle)."""
    times = (float(press), float(press + turn))
    top = {**turned("top", angle, times).__dict__, "point": [middle, middle, 0.0]}
    return Scene(
        title="A pad turns on a plane",
        mesh=MeshSpec(path, strain="finite"),
        materials={"m": Material(1e4, 0.0, law="neo_hooke")},
        bodies=[Body(body, "m")],
        contacts=[Contact("bottom", obstacle=Obstacle("plane", point=[0.0] * 3, normal=[0.0, 0.0, 1.0]), name="plane",
                          friction=0.3)],
        displacements=[lowered("top", 1e-4 * THICKNESS, times), Displacement(**top)],
        steps=Steps(end=times[1], count=press + turn),
        **more,
    )  # fmt: skip


def pad_scene(path, press, turn, angle=ANGLE, **more):
    """The soft pad, held and pressed at its top, on the ring that turns."""
    times = (float(press), float(press + turn))
    return Scene(
        title="A pad on a ring that turns",
        mesh=MeshSpec(path, strain="finite"),
        materials={"ring": Material(100.0, 0.3, law="neo_hooke"), "pad": Material(1.0, 0.3, law="neo_hooke")},
        bodies=[Body("ring", "ring"), Body("pad", "pad")],
        contacts=[Contact("pad_bottom", "ring_top", name="sole", friction=0.3, search="ray_tracing")],
        displacements=[
            lowered("pad_top", 0.002, times, 0.0),
            Displacement("ring_bottom", ["free", "free", 0.0]),
            turned("ring_bottom", angle, times),
        ],
        steps=Steps(end=times[1], count=press + turn),
        **more,
    )


def bound(simulation, mu, point=(0.0, 0.0)):
    """Integrals of mu p r over the deformed source, and of mu p, p the pressure. *Collective.*"""
    pair, u = simulation.problem.contacts[0].pairs[0], simulation.stepper.u
    state = pair.state(u)
    place = pair.search.deformed(simulation.problem.space.local.gather(u)) + pair.search.origin
    force = mu * state["pressure"] * state["weight"]
    arm = np.linalg.norm(place[:, :2] - np.asarray(point), axis=1)
    return simulation.comm.allreduce(np.array([force @ arm, force.sum()]))


def solve(args, name, scene, mu, point=(0.0, 0.0)):
    """Records with times, whether all load steps converged, last norms, the bound, unknowns, and seconds."""
    rows, start = Rows(), time.perf_counter()
    with running(scene, args.o / name, [rows]) as (simulation, converged):
        seconds = time.perf_counter() - start
        ends = bound(simulation, mu, point)
        return rows.records, converged, list(simulation.newton.norms), ends, simulation.problem.space.n_dofs, seconds


def hemisphere(args, petsc):
    """The hemisphere on meshes of several sizes."""
    sizes, steps = ((2,), (4, 2)) if args.tiny else (args.n or (4, 8, 12, 16), args.steps)
    depth, angle = (0.2, 10.0) if args.tiny else (DEPTH, ANGLE)
    rows, records, converged, curves, table = [], [], True, {}, []
    for n in sizes:
        path = make_mesh(hemisphere_on_cube, args.o / f"hemisphere_{n}.msh", n, inner=INNER)
        scene = hemisphere_scene(path, *steps, depth, angle, output=Output(fields=args.fields), petsc=petsc)
        some, ended, norms, (most, _), unknowns, seconds = solve(args, f"hemisphere_{n}", scene, 0.5)
        records, converged = records + some, converged and ended
        if not ended:
            break
        force, moment = pull(some)
        rows.append((f"moment at {angle:g} degrees, n {n}; expected: its bound", most, moment[-1]))
        curves[n] = (angle * np.clip((times(some) - steps[0]) / steps[1], 0.0, None), force, moment)
        solves = elastic(args, n, petsc) if args.linear else float("nan")
        newton = [record["newton"] for record in some]
        cuts, krylov = (sum(record[key] for record in some) for key in ("cutbacks", "krylov"))
        table.append((n, unknowns, force[steps[0] - 1], force[-1], moment[-1], moment[-1] / most, np.mean(newton), cuts,
                      krylov / sum(newton), seconds / len(some), seconds / len(some) / solves))  # fmt: skip
        if args.fields:
            view = {"field": "equivalent_stress", "output": args.o / f"hemisphere_{n}.png"}
            on_root(MPI.COMM_WORLD, lambda n=n, view=view: picture(args.o / f"hemisphere_{n}", **view))
    header = ("n", "unknowns", "force, pressed", "force, turned", "moment", "moment / bound", "Newton", "cut",
              "Krylov per Newton", "s per load step", "in linear solves")  # fmt: skip
    print_table("hemisphere", header, table)
    _curves(args, curves)
    return Found(rows, records, converged, norms)


def times(records):
    """Times of the load steps, (n,)."""
    return np.array([record["time"] for record in records])


def pull(records, region="hemisphere_top"):
    """Force down and moment about the axis by load step, (n,) both."""
    force = np.array([abs(record["reactions"][region][2]) for record in records])
    return force, np.array([abs(record["moments"][region][2]) for record in records])


def elastic(args, n, petsc):
    """Seconds of a linear elastic load step with bonded bodies on a mesh of the hemisphere. *Collective.*"""
    path = args.o / f"hemisphere_{n}.msh"
    scene = hemisphere_scene(path, 1, 1, 1e-6, 1e-6, output=Output(fields=False), petsc=petsc)
    scene.mesh.strain, scene.contacts = "small", []
    scene.materials = {name: Material(m.E, m.nu) for name, m in scene.materials.items()}
    rows, start = Rows(), time.perf_counter()
    with running(scene, args.o / "elastic", [rows]):
        return (time.perf_counter() - start) / len(rows.records)


def _curves(args, curves):
    """Draw force and moment over the angle."""

    def paint(axes):
        for n, (angle, force, moment) in curves.items():
            on = angle > 0.0
            axes[0].plot(angle[on], force[on], label=f"n {n}")
            axes[1].plot(angle[on], moment[on], label=f"n {n}")
        for ax, text in zip(axes, ("force", "moment"), strict=True):
            ax.set(xlabel="angle [degrees]", ylabel=text)
            ax.legend(frameon=False)
            ax.grid(alpha=0.3)

    draw(args.o / "hemisphere.png", paint, columns=2, size=(4.2, 3.2), dpi=110)


def torque(args, petsc):
    """The square pad on the plane."""
    n = 4 if args.tiny else 8
    path = make_mesh(one_block, args.o / "block.msh", 3, (n, n, 1), size=(1.0, 1.0, THICKNESS))
    return on_plane(args, petsc, path, "torque", SQUARE)


def round_pad(args, petsc):
    """The round one."""
    path = make_mesh(disk, args.o / "disk.msh", 4 if args.tiny else 12, 1, thickness=THICKNESS)
    return on_plane(args, petsc, path, "disk", 2.0 / 3.0, body="disk", middle=0.0)


def on_plane(args, petsc, path, name, mean, **pad):
    """A pad on the plane, in load steps of several angles; `mean` is the mean distance from its middle."""
    rows, records, converged = [], [], True
    for turn, angle in ((2, 10.0),) if args.tiny else ((9, ANGLE), (18, ANGLE), (36, ANGLE)):
        scene = torque_scene(path, 1, turn, angle, **pad, output=Output(fields=False), petsc=petsc)
        some, ended, norms, _, _, _ = solve(args, f"{name}_{turn}", scene, 0.3)
        records, converged = records + some, converged and ended
        force, moment = pull(some, "top")
        # the first load step of the turn has less of a way
        off = np.abs(moment[2:] - moment[-1]).max() / moment[-1] if turn > 2 else 0.0
        log.info("%s, %d load steps: moment %.7g, changes by %.1e of it", name, turn, moment[-1], off)
        found = moment[-1] / (0.3 * force[-1])
        rows.append((f"moment / (mu N), load steps of {angle / turn:g} degrees", mean, found))
    return Found(rows, records, converged, norms)


def pad(args, petsc):
    """The pad on the ring that turns."""
    n, steps, angle = (2, (1, 1), 5.0) if args.tiny else (8, (2, 18), ANGLE)
    path = make_mesh(pad_on_ring, args.o / "pad.msh", n)
    scene = pad_scene(path, *steps, angle, output=Output(fields=args.fields), petsc=petsc)
    records, converged, norms, (most, force), _, _ = solve(args, "pad", scene, 0.3)
    _, moment = pull(records, "ring_bottom")
    x = (np.arange(400) + 0.5) / 400.0 - 0.5
    mean = np.hypot(0.7 + 0.4 * x[:, None], 0.4 * x).mean()
    rows = [("moment; expected: the integral of mu p r", most, moment[-1]),
            ("moment; expected: mu N times the mean distance", force * mean, moment[-1])]  # fmt: skip
    return Found(rows, records, converged, norms)


MAKERS = {"hemisphere": hemisphere, "torque": torque, "disk": round_pad, "pad": pad}


def run(args):
    """All cases asked for; 1 where one does not converge or misses its numbers."""
    return compare(args, MAKERS, BOUNDS, "turning", {"snes_rtol": "1e-9"})


if __name__ == "__main__":
    parser = case_parser(__doc__, "turning", CASES, n="+")
    text = "load steps of the hemisphere that press and that turn (default: %(default)s)"
    parser.add_argument("--steps", type=int, nargs=2, default=[10, 9], help=text)
    parser.add_argument("--linear", action="store_true", help="time of a linear elastic solve on the same meshes")
    main(run, parser)
