"""Hertz: cylinders, a cylinder on a block, a ball on a block, two balls, against the closed form.

    mpirun -n 2 python drivers/cases/hertz.py --case cylinders --order 2 --levels 3 -o cylinders

Half (2D) or quarter (3D) models. Half width and peak pressure come from a fit of Hertz's profile to the
contact pressure at the quadrature points, beside them the half width from the closed area and the largest
pressure. All of it is a function of the reference position: bodies of equal material move alike along the
contact surface, and Hertz's gap is between points that start from the same place. The closed form is
evaluated twice: with the force that was computed, and with what the case prescribes (force, or approach of
the flat sides).

Every load step (--steps) renews the search, on the bodies as the step before left them. --hold adds steps
at the full load, which do nothing but renew the search; after two of them what is left is below 0.1 %.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers._common import (
    contact_points,
    draw,
    log,
    main,
    make_mesh,
    make_parser,
    print_table,
    running,
    write_json,
)
from meshes.hertz import ball_on_block, cylinder_on_block, cylinders, two_balls
from pcontact.runtime.errors import InputError
from pcontact.runtime.observer import Observer
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene, Steps

FREE = "free"
COLUMNS = ("h", "unknowns", "steps", "newton", "krylov", "a_fit", "a_area", "p0_fit", "p0_max", "force")
ROWS = (("half width, fit", "a_fit"), ("half width, area", "a_area"),
        ("peak pressure, fit", "p0_fit"), ("peak pressure, largest", "p0_max"))  # fmt: skip
INNER = 0.95  # part of the closed radius in which the profile is fitted: beyond it the last facet decides


@dataclass(frozen=True)
class Case:
    """A pair of round bodies.

    Attributes
    ----------
    generator : callable
        Of :mod:`meshes.hertz`.
    dim : int
    E, nu : float
        Of both bodies.
    radius : float
        Of relative curvature, 1 / (1 / R_1 + 1 / R_2) [length].
    upper, lower : str
        Bodies; the upper one is the source.
    driven, held : str
        Where the load acts and where the lower body is held.
    half_width : float
        About what is expected: sets the default mesh [length].
    displacement, counter : float
        Of the driven side, when that is prescribed, and of the held side [length].
    pressure, force : float
        On the driven side, when the force is prescribed [stress], and its resultant on the whole bodies.
    far : bool
        Whether Hertz's approach is compared with the prescribed one.
    """

    generator: Callable
    dim: int
    E: float
    nu: float
    radius: float
    upper: str
    lower: str
    driven: str
    held: str
    half_width: float
    displacement: float
    pressure: float = 0.0
    force: float = 0.0
    counter: float = 0.0
    far: bool = False

    @property
    def skins(self) -> tuple[str, str]:
        """Source and target surface."""
        return f"{self.upper}_skin", f"{self.lower}_{'top' if self.lower == 'block' else 'skin'}"

    @property
    def copies(self) -> int:
        """Whole bodies in units of the model."""
        return 2 if self.dim == 2 else 4

    def scaled(self, factor: float) -> "Case":
        """The case with a smaller load: half widths go with its square root or a little faster."""
        return replace(
            self,
            half_width=self.half_width * np.sqrt(factor),
            displacement=self.displacement * factor,
            counter=self.counter * factor,
            force=self.force * factor,
            pressure=self.pressure * factor,
        )

    @property
    def modulus(self) -> float:
        """E* of the pair [stress]."""
        return self.E / (2.0 * (1.0 - self.nu**2))

    def from_force(self, force: float) -> tuple[float, float]:
        """Half width and peak pressure of Hertz for a force (2D: per length) on the whole bodies."""
        if self.dim == 2:
            a = np.sqrt(4.0 * force * self.radius / (np.pi * self.modulus))
            return a, 2.0 * force / (np.pi * a)
        a = np.cbrt(3.0 * force * self.radius / (4.0 * self.modulus))
        return a, 3.0 * force / (2.0 * np.pi * a**2)

    def from_approach(self, approach: float) -> tuple[float, float]:
        """Half width and peak pressure of Hertz for an approach of two balls."""
        a = np.sqrt(self.radius * approach)
        return a, 2.0 * self.modulus * a / (np.pi * self.radius)


CASES = {
    "cylinders": Case(
        cylinders, 2, 200.0, 0.3, 4.0, "upper", "lower", "upper_flat", "lower_flat",
        half_width=0.680778, displacement=-0.194, pressure=0.625, force=10.0,
    ),
    "cylinder_on_block": Case(
        cylinder_on_block, 2, 200.0, 0.3, 8.0, "cylinder", "block", "cylinder_flat", "block_bottom",
        half_width=0.962766, displacement=-0.214, pressure=0.625, force=10.0,
    ),
    "ball_on_block": Case(
        ball_on_block, 3, 1000.0, 0.3, 1.0, "ball", "block", "ball_top", "block_bottom",
        half_width=0.147, displacement=-0.02,
    ),
    "two_balls": Case(
        two_balls, 3, 20000.0, 0.3, 25.0, "upper", "lower", "upper_flat", "lower_flat",
        half_width=10.0, displacement=-2.0, counter=2.0, far=True,
    ),
}  # fmt: skip


def generate(
    case: Case, path: Path, h: float | None, order: int, unknowns: int | None = None, finer: float | None = None
) -> Path:
    """The mesh of a case with element size `h` at the contact, or with a number of unknowns. *Collective.*

    `finer` has the elements far from the contact grow less, too, by this factor.
    """
    options: dict = {"order": order}
    if case.dim == 2:
        # far from the contact an eighth of the radius is fine enough: a and p0 change by less than 0.1 %
        options.update(half=True, coarse=1.0)
    else:
        options["symmetry"] = "quarter"
    if finer is not None:
        options["growth"] = min(0.5, (0.25 if case.dim == 2 else 0.35) / finer)
        options["coarse"] = min(2.0, 1.0 / finer) if case.dim == 2 else None
    options["contact_radius"] = 1.5 * case.half_width
    if unknowns is not None:
        options["unknowns"] = unknowns
    else:
        options["h"] = h
    return make_mesh(case.generator, path, **options)


def make_scene(case: Case, mesh: Path, args) -> Scene:
    """The scene of a case; `args` has case, order, theta, gamma0, drive, steps, hold, fields."""
    along = [FREE] * (case.dim - 1)
    # time counts the steps: those that load, then those that hold
    end = float(args.steps + args.hold)
    ramp = None if args.hold == 0 else [[0.0, 0.0], [float(args.steps), 1.0], [end, 1.0]]
    displacements = [
        Displacement("symmetry_x", [0.0, *along]),
        Displacement(case.held, [*along, case.counter], ramp),
    ]
    if case.dim == 3:
        displacements.append(Displacement("symmetry_y", [FREE, 0.0, FREE]))
    loads = []
    if args.drive == "force":
        loads.append(Load(case.driven, pressure=case.pressure, amplitude=ramp))
    else:
        displacements.append(Displacement(case.driven, [*along, case.displacement], ramp))
    source, target = case.skins
    return Scene(
        mesh=MeshSpec(mesh, order=args.order),
        materials={"elastic": Material(case.E, case.nu)},
        bodies=[Body(case.upper, "elastic"), Body(case.lower, "elastic")],
        contacts=[Contact(source, target, theta=args.theta, gamma0=args.gamma0)],
        displacements=displacements,
        loads=loads,
        steps=Steps(end=end, count=args.steps + args.hold),
        output=Output(fields=args.fields, probes=[case.driven]),
        title=f"Hertz: {args.case.replace('_', ' ')}",
    )


def fit(r: np.ndarray, pressure: np.ndarray, weight: np.ndarray, radius: float) -> tuple[float, float]:
    """Half width and peak pressure of the profile p^2 = p0^2 (1 - r^2 / a^2) nearest to the points.

    Parameters
    ----------
    r, pressure, weight : ndarray (n,)
        Distance from the axis [length], contact pressure [stress], area of the point.
    radius : float
        Of the closed area [length]; points near its edge and beyond are left out.

    Returns
    -------
    float, float
        a, p0; not a number where there are too few points.
    """
    inner = r < INNER * radius
    if np.unique(np.round(r[inner] / max(radius, 1e-300), 6)).size < 3:
        return float("nan"), float("nan")
    slope, square = np.polyfit(r[inner] ** 2, pressure[inner] ** 2, 1, w=np.sqrt(weight[inner]))
    if slope >= 0 or square <= 0:
        return float("nan"), float("nan")
    return float(np.sqrt(-square / slope)), float(np.sqrt(square))


def measure(case: Case, points: dict[str, np.ndarray]) -> dict[str, float]:
    """Half widths, peak pressures and force (on the whole bodies) from the quadrature points."""
    closed = points["status"] > 0
    r = np.linalg.norm(points["x"][:, : case.dim - 1], axis=1)
    area = case.copies * points["weight"][closed].sum()
    radius = 0.5 * area if case.dim == 2 else np.sqrt(area / np.pi)
    a, p0 = fit(r, points["pressure"], points["weight"], radius)
    force = case.copies * float((points["traction"][:, case.dim - 1] * points["weight"]).sum())
    return {
        "a_fit": a,
        "a_area": float(radius),
        "p0_fit": p0,
        "p0_max": float(points["pressure"].max(initial=0.0)),
        "force": force,
    }


def solve(case: Case, mesh: Path, args, directory: Path | None = None) -> tuple[dict, dict | None, bool]:
    """Run a case on a mesh. *Collective.*

    Returns
    -------
    result : dict
        What was measured, the same on every rank: see `measure`; reaction and applied force on the whole
        bodies, displacement of the driven side, number of unknowns, Newton and Krylov iterations, and Hertz's
        half width and pressure for the computed force (a_hertz, p0_hertz) and for what is prescribed
        (a_given, p0_given).
    points : dict or None
        The quadrature points, on rank 0.
    converged : bool
    """
    counts = Counts()
    with running(make_scene(case, mesh, args), directory, [counts]) as (simulation, converged):
        problem, u = simulation.problem, simulation.stepper.u
        points = contact_points(simulation)
        result = simulation.comm.bcast(None if points is None else measure(case, points), root=0)
        last, reactions = case.dim - 1, problem.forces.reactions(u)
        result["reaction"] = case.copies * reactions[case.held][last]
        applied = -reactions[case.driven][last] if args.drive == "displacement" else 0.0
        result["applied"] = case.force if args.drive == "force" else case.copies * applied
        result["unknowns"] = problem.space.n_dofs
        result.update(counts.totals)
    result["a_hertz"], result["p0_hertz"] = case.from_force(max(result["force"], 0.0) or np.nan)
    result["a_given"], result["p0_given"] = float("nan"), float("nan")
    if args.drive == "force":
        result["a_given"], result["p0_given"] = case.from_force(case.force)
    elif case.far:
        result["a_given"], result["p0_given"] = case.from_approach(case.counter - case.displacement)
    return result, points, converged


class Counts(Observer):
    """Observer: iterations of the whole run, and the displacement of the driven side.

    Attributes
    ----------
    totals : dict
        steps, newton, krylov, cutbacks, displacement.
    """

    def __init__(self):
        self.totals = {"steps": 0, "newton": 0, "krylov": 0, "cutbacks": 0, "displacement": 0.0}

    def step(self, step, u, record):
        """Add a step."""
        self.totals["steps"] += 1
        for key in ("newton", "krylov", "cutbacks"):
            self.totals[key] += record[key]
        self.totals["displacement"] = next(iter(record["probes"].values()))["mean"][-1]


def percent(value: float, reference: float) -> str:
    """Deviation in percent, as text."""
    return "-" if not np.isfinite(value / reference) else f"{100.0 * (value / reference - 1.0):+.2f} %"


def report(case: Case, rows: list[dict]) -> None:
    """Tables: all meshes, and the finest one against the closed form."""
    table = [
        [row[k] for k in COLUMNS] + [percent(row[f"{k}_fit"], row[f"{k}_hertz"]) for k in ("a", "p0")] for row in rows
    ]
    header = [*(k.replace("_", " ") for k in COLUMNS), "a/Hertz(force)", "p0/Hertz(force)"]
    print_table("computed, mesh by mesh (force on the whole bodies)", header, table)
    last, table = rows[-1], []
    for text, key in ROWS:
        of = key.split("_")[0]
        hertz, given = last[f"{of}_hertz"], last[f"{of}_given"]
        table.append([text, last[key], hertz, percent(last[key], hertz), given, percent(last[key], given)])
    header = ["", "computed", "Hertz, computed force", "deviation", "Hertz, as prescribed", "deviation"]
    print_table("last mesh against the closed form", header, table)
    log.info(
        "force through the contact %.8g, reaction of %s %.8g, applied on %s %.8g (whole bodies)",
        last["force"], case.held, last["reaction"], case.driven, last["applied"],
    )  # fmt: skip


def plot(path: Path, case: Case, points: dict | None, row: dict) -> None:
    """Pressure at the quadrature points over the profile of Hertz for the computed force."""

    def paint(axes):
        a, p0 = row["a_hertz"], row["p0_hertz"]
        r = np.linalg.norm(points["x"][:, : case.dim - 1], axis=1)
        near = r < 1.4 * a
        s = np.linspace(0.0, 1.0, 400)
        axes.plot(r[near] / a, points["pressure"][near] / p0, ".", ms=3, color="#c8553d", label="computed")
        axes.plot(np.append(s, 1.4), np.append(np.sqrt(1 - s**2), 0.0), color="#1c2733", lw=1, label="Hertz")
        axes.set(xlabel="distance from the axis / a", ylabel="contact pressure / p0", xlim=(0, 1.4))
        axes.set_title(f"Hertz for the computed force: a = {a:.5g}, p0 = {p0:.5g}", fontsize=9)
        axes.legend(frameon=False)

    draw(path, paint)


def check(args) -> Case:
    """The case that the arguments name; fills in what they leave open.

    Raises
    ------
    InputError
        Arguments that do not go together.
    """
    case = CASES[args.case]
    if args.unknowns is not None and case.generator is not ball_on_block:
        raise InputError(f"command line: --unknowns with {args.case}, allowed: with --case ball_on_block")
    if args.drive is None:
        args.drive = "force" if case.force else "displacement"
    if args.drive == "force" and not case.force:
        raise InputError(f"command line: --drive force with --case {args.case}, allowed: with the cylinders")
    for name, least in (("hold", 0), ("steps", 1), ("levels", 1)):
        found = getattr(args, name)
        if found < least:
            raise InputError(f"command line: --{name}: found {found}, allowed: at least {least}")
    return case


def run(args) -> int:
    """All meshes of a case; the exit status."""
    case = check(args)
    facets = 5 if args.tiny and case.dim == 3 else 20 if case.dim == 2 else 8
    size = args.h or case.half_width / facets
    rows, good = [], True
    for level in range(args.levels):
        h, directory = size / 2**level, args.o if args.levels == 1 else args.o / f"level{level}"
        wanted = None if args.unknowns is None else args.unknowns * (1 << (case.dim * level))
        mesh = generate(case, args.o / f"{args.case}_{level}.msh", h, args.order, wanted)
        row, points, converged = solve(case, mesh, args, directory)
        rows.append({"h": float("nan") if wanted else h, **row})
        if not converged:
            good = False
            break
    report(case, rows)
    keep = ("case", "order", "theta", "gamma0", "drive", "steps", "hold")
    write_json(args.o / "hertz.json", {**{key: getattr(args, key) for key in keep}, "levels": rows})
    plot(args.o / "pressure.png", case, points, rows[-1])
    return 0 if good else 1


def make_options():
    """The parser of this driver."""
    parser = make_parser(__doc__, "hertz_results")
    add = parser.add_argument
    add("--case", choices=sorted(CASES), default="cylinders")
    add("--h", type=float, help="element size at the contact (default: half width / 20, 3D: / 8)")
    add("--unknowns", type=int, help="instead of --h: size of the problem (ball_on_block)")
    add("--levels", type=int, default=1, help="meshes, each of half the size of the one before")
    add("--order", type=int, choices=(1, 2), default=1, help="degree of displacement and geometry")
    add("--theta", type=float, choices=(1.0, 0.0, -1.0), help="variant of Nitsche's method")
    add("--gamma0", type=float, help="dimensionless Nitsche parameter")
    add("--drive", choices=("force", "displacement"), help="cylinders: what is prescribed (force)")
    add("--steps", type=int, default=1, help="equal load steps to start with (1)")
    add("--hold", type=int, default=2, help="steps at the full load, which renew the search (2)")
    add("--fields", action="store_true", help="write fields, for pcontact view and ParaView")
    return parser


if __name__ == "__main__":
    main(run, make_options())
