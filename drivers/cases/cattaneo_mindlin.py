"""Cattaneo and Mindlin: two cylinders pressed together, then sheared, against the closed form.

    mpirun -n 2 python drivers/cases/cattaneo_mindlin.py -o cattaneo_mindlin

Under a force Q below mu P along the contact, the points within c = a sqrt(1 - Q / (mu P)) of the middle stick and the
others slip. The lower flat side is fixed. The upper one is pressed down by a displacement u_y in --press steps, which
then stays: the force Q at a lever of one radius would roll the cylinder out of the contact. It is a traction along
the flat side, free to move along x, so Q is known beforehand and P is measured; it hardly changes under Q (bodies of
equal material). The closed form is evaluated for this P, and for the P = 10 that the displacement was chosen for.

A step counts as slip the whole tangential motion of a pair of points, also of one that it closes. Curved surfaces
that close turn into a common tangent, so pressing in few steps leaves tractions that the closed form does not have:
c is 25 % off after one step, 0.1 % after ten or more.

With cells of degree 1 the stress is constant in a cell, and where the edge of the stick zone falls is known to a facet.
c therefore comes from a fit inside the stick zone, and the variation of the profile is that of the facets' means.
"""

from pathlib import Path

import numpy as np

from drivers._common import draw, log, main, make_mesh, make_parser, print_table, running, write_json
from drivers.cases.hertz import CASES, FREE, INNER, fit, percent
from meshes.hertz import cylinders
from pcontact.runtime.errors import InputError
from pcontact.runtime.observer import Observer
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene, Steps

CASE = CASES["cylinders"]
SHEAR = 0.05851  # traction along the flat side [stress]
FORCE = 16.0 * SHEAR  # on the whole side [force / length]
DISPLACEMENT = -0.18817  # of the upper flat side: P = 10 on the default mesh
THETAS = (1.0, 0.0, -1.0)
OPEN, STICK, SLIP = 0, 1, 2


def closed_form(x: np.ndarray, load: float, shear: float, mu: float) -> tuple[float, float, np.ndarray]:
    """Stick half width c, traction at its edge, and the profile, after Cattaneo and Mindlin.

    Parameters
    ----------
    x : ndarray (n,)
        [length]
    load, shear : float
        P and Q per unit of thickness [force / length].
    mu : float
        Coefficient of friction.

    Returns
    -------
    c : float
        [length]
    edge : float
        Traction at abs(x) = c [stress].
    profile : ndarray (n,)
        [stress]
    """
    a, p0 = CASE.from_force(load)
    c = a * np.sqrt(max(1.0 - shear / (mu * load), 0.0))
    outer, inner = (np.sqrt(np.maximum(b**2 - np.asarray(x) ** 2, 0.0)) for b in (a, c))
    return float(c), float(mu * p0 * np.sqrt(1.0 - (c / a) ** 2)), mu * p0 / a * (outer - inner)


def make_scene(mesh: Path, args, theta: float) -> Scene:
    """The scene; `args` has order, mu, gamma0, displacement, press, steps, fields. Time counts the steps."""
    pressed, end = float(args.press), float(args.press + args.steps)
    down = [[0.0, 0.0], [pressed, 1.0], [end, 1.0]]
    along = [[0.0, 0.0], [pressed, 0.0], [end, 1.0]]
    return Scene(
        mesh=MeshSpec(mesh, order=args.order),
        materials={"elastic": Material(CASE.E, CASE.nu)},
        bodies=[Body("upper", "elastic"), Body("lower", "elastic")],
        contacts=[Contact(*CASE.skins, name="skins", friction=args.mu, theta=theta, gamma0=args.gamma0)],
        displacements=[
            Displacement("lower_flat", [0.0, 0.0]),
            Displacement("upper_flat", [FREE, args.displacement], down),
        ],
        loads=[Load("upper_flat", traction=[SHEAR, 0.0], amplitude=along)],
        steps=Steps(end=end, count=args.press + args.steps),
        output=Output(fields=args.fields),
        title="Cattaneo and Mindlin",
    )


class History(Observer):
    """Observer: what happened in every step.

    Attributes
    ----------
    steps : list of dict
        time, newton, krylov, cutbacks; force (d,) through the contact, reaction (d,) of the upper flat side.
    """

    def __init__(self):
        self.steps = []

    def step(self, step, u, record):
        """Add a step."""
        row = {key: record[key] for key in ("time", "newton", "krylov", "cutbacks")}
        row["force"] = record["contacts"]["skins"]["force"]
        self.steps.append({**row, "reaction": record["reactions"]["upper_flat"]})


def points_of(simulation) -> dict[str, np.ndarray] | None:
    """The quadrature points, sorted along x, on rank 0. *Collective.*

    Returns
    -------
    dict of str to ndarray (n,), or None on other ranks
        ``x``, ``tangential`` (against the shear that acts on the source) and ``pressure`` [stress], ``status``,
        ``weight``, ``facet`` (a number per facet).
    """
    comm = simulation.comm
    item = simulation.problem.contacts[0]
    state, facet = item.state(simulation.stepper.u), item.source.facet
    before = comm.scan(len(item.source.size)) - len(item.source.size)
    # the tangent that is normal to n = (0, -1) is (1, 0)
    normal, traction = state["normal"], state["traction"]
    tangential = normal[:, 1] * traction[:, 0] - normal[:, 0] * traction[:, 1]
    own = {key: state[key] for key in ("pressure", "status", "weight")}
    own.update(x=state["x"][:, 0], tangential=tangential, facet=facet + before)
    parts = comm.gather(own, root=0)
    if parts is None:
        return None
    joined = {key: np.concatenate([part[key] for part in parts]) for key in own}
    order = np.argsort(joined["x"], kind="stable")
    return {key: value[order] for key, value in joined.items()}


def facet_means(points: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Means of x, tangential traction and pressure over each facet, sorted along x."""
    _, inverse = np.unique(points["facet"], return_inverse=True)
    total = np.bincount(inverse, points["weight"])
    keys = ("x", "tangential", "pressure")
    means = {key: np.bincount(inverse, points["weight"] * points[key]) / total for key in keys}
    order = np.argsort(means["x"])
    return {key: value[order] for key, value in means.items()}


def stick_fit(points: dict[str, np.ndarray], mu: float) -> tuple[float, float]:
    """Half width and middle of the stick zone, from (mu p - tau)^2, which is a parabola there.

    Returns
    -------
    c, middle : float
        [length]; not a number where nothing sticks.
    """
    sticks = points["status"] == STICK
    radius = 0.5 * points["weight"][sticks].sum()
    if radius == 0.0:
        return float("nan"), float("nan")
    about = np.average(points["x"][sticks], weights=points["weight"][sticks])
    inner = np.abs(points["x"] - about) < INNER * radius
    if inner.sum() < 4:
        return float("nan"), float("nan")
    square = (mu * points["pressure"] - points["tangential"])[inner] ** 2
    bent, slope, top = np.polyfit(points["x"][inner], square, 2, w=np.sqrt(points["weight"][inner]))
    middle = -0.5 * slope / bent
    return float(np.sqrt(max(middle**2 - top / bent, 0.0))), float(middle)


def edge_traction(points: dict[str, np.ndarray], c: float, a: float) -> float:
    """Traction at abs(x) = c, the edges of the stick zone, from tau^2 of the slip zones, which is linear in x^2."""
    r = np.abs(points["x"])
    slips = (points["status"] == SLIP) & (r > c) & (r < INNER * a)
    if slips.sum() < 3:
        return float("nan")
    line = np.polyfit(r[slips] ** 2, points["tangential"][slips] ** 2, 1, w=np.sqrt(points["weight"][slips]))
    return float(np.sqrt(max(np.polyval(line, c**2), 0.0)))


def variation(values: np.ndarray) -> float:
    """Total variation of values in order, from zero to zero."""
    return float(np.abs(np.diff(values, prepend=0.0, append=0.0)).sum())


def measure(points: dict[str, np.ndarray], load: float, mu: float) -> dict[str, float]:
    """What is compared with the closed form for P = `load`."""
    weight, status = points["weight"], points["status"]
    radius = 0.5 * weight[status > OPEN].sum()
    a, p0 = fit(np.abs(points["x"]), points["pressure"], weight, radius)
    c, middle = stick_fit(points, mu)
    means = facet_means(points)
    ratios = {}
    for name, values in (("points", points), ("facets", means)):
        exact = closed_form(values["x"], load, FORCE, mu)[2]
        ratios[f"variation_{name}"] = variation(values["tangential"]) / variation(exact)
    a_hertz, p0_hertz = CASE.from_force(load)
    c_exact, edge_exact, _ = closed_form(means["x"], load, FORCE, mu)
    return {
        "a_fit": a, "a_hertz": a_hertz, "p0_fit": p0, "p0_hertz": p0_hertz,
        "c_fit": c, "c_area": float(0.5 * weight[status == STICK].sum()), "c_exact": c_exact, "middle": middle,
        "edge": edge_traction(points, c, a), "edge_exact": edge_exact,
        "peak": float(np.max(means["tangential"], initial=0.0)), **ratios,
    }  # fmt: skip


def solve(mesh: Path, args, theta: float, directory: Path | None = None) -> tuple[dict, dict | None, bool]:
    """Run on a mesh with one variant of Nitsche's method. *Collective.*

    Returns
    -------
    result : dict
        See `measure`; ``load`` is P, ``applied`` and ``force`` the shear that acts on the flat side and that goes
        through the contact, ``balance`` their relative difference, ``steps`` the history, ``newton`` the iterations
        of each step.
    points : dict or None
        See `points_of`.
    converged : bool
    """
    history = History()
    with running(make_scene(mesh, args, theta), directory, [history]) as (simulation, converged):
        points = points_of(simulation)
        last = history.steps[-1] if history.steps else {"force": [np.nan, np.nan], "reaction": [np.nan, np.nan]}
        result = {"theta": theta, "unknowns": simulation.problem.space.n_dofs, "steps": history.steps}
        result.update(load=-last["reaction"][1], force=last["force"][0], applied=FORCE)
        result["newton"] = [step["newton"] for step in history.steps]
        result["balance"] = abs(result["force"] / result["applied"] - 1.0)
        if converged:
            measured = None if points is None else measure(points, result["load"], args.mu)
            result.update(simulation.comm.bcast(measured, root=0))
    return result, points, converged


def report(rows: list[dict], args) -> None:
    """Tables of all variants."""
    header = ["theta", "P", "c, fit", "c, area", "exact", "deviation", "tau at c", "exact", "deviation", "largest mean",
              "variation, points", "facets", "Q off by"]  # fmt: skip
    table = [
        [row["theta"], row["load"], row["c_fit"], row["c_area"], row["c_exact"], percent(row["c_fit"], row["c_exact"]),
         row["edge"], row["edge_exact"], percent(row["edge"], row["edge_exact"]), row["peak"],
         row["variation_points"], row["variation_facets"], f"{row['balance']:.1e}"]
        for row in rows
    ]  # fmt: skip
    print_table("after shear; exact: closed form for the computed P", header, table)
    table = []
    for row in rows:
        a, p0 = percent(row["a_fit"], row["a_hertz"]), percent(row["p0_fit"], row["p0_hertz"])
        steps = row["newton"]
        shear = len(steps) - args.steps
        table.append([row["theta"], row["unknowns"], row["a_fit"], a, row["p0_fit"], p0,
                      " ".join(map(str, steps[:shear])), " ".join(map(str, steps[shear:]))])  # fmt: skip
    header = ["theta", "unknowns", "a", "of Hertz", "p0", "of Hertz", "Newton, pressing", "Newton, shear"]
    print_table("pressure, iterations", header, table)
    c, edge, _ = closed_form(np.zeros(1), CASE.force, FORCE, args.mu)
    log.info("closed form for P = %g: c = %.6f, traction at its edge %.6f", CASE.force, c, edge)


def plot(path: Path, rows: list[dict], profiles: list[dict | None], mu: float) -> None:
    """Tangential traction over the closed form, all variants."""

    def paint(axes):
        colours, marks = ("#c8553d", "#2f6690", "#588b3f"), (".", "x", "+")
        x = np.linspace(-1.3, 1.3, 2001) * rows[0]["a_hertz"]
        load = rows[0]["load"]
        axes.plot(x, closed_form(x, load, FORCE, mu)[2], color="#1c2733", lw=1, label="closed form")
        a, p0 = CASE.from_force(load)
        bound = mu * p0 * np.sqrt(np.maximum(1.0 - (x / a) ** 2, 0.0))
        axes.plot(x, bound, "--", color="#8a949c", lw=0.8, label="mu p")
        for row, points, colour, mark in zip(rows, profiles, colours, marks, strict=False):
            near = np.abs(points["x"]) < 1.3 * a
            label = f"theta = {row['theta']:g}"
            axes.plot(points["x"][near], points["tangential"][near], mark, ms=3, mew=0.6, color=colour, label=label)
        axes.set(xlabel="x", ylabel="tangential traction", xlim=(-1.3 * a, 1.3 * a))
        axes.legend(frameon=False, fontsize=8, loc="lower center")

    draw(path, paint, size=(8.0, 4.8))


def check(args) -> None:
    """Fill in what the arguments leave open.

    Raises
    ------
    InputError
        Numbers that make no case: the whole contact would slide.
    """
    least = SHEAR / CASE.pressure
    if not args.mu > least:
        raise InputError(f"command line: --mu: found {args.mu}, allowed: more than q / p = {least:.6g}")
    for name, smallest in (("press", 1), ("steps", 1)):
        found = getattr(args, name)
        if found < smallest:
            raise InputError(f"command line: --{name}: found {found}, allowed: at least {smallest}")
    if args.h is None:
        args.h = CASE.half_width / (11.0 if args.tiny else 22.0)
    if args.tiny:
        args.press, args.steps = min(args.press, 2), 1


def generate(path: Path, args, finer: float = 1.0) -> Path:
    """The mesh; far from the contact an eighth of the radius is fine enough. *Collective.*

    `finer` has the elements far from the contact grow less, too, by this factor.
    """
    return make_mesh(
        cylinders, path, h=args.h, order=args.order, contact_radius=1.5 * CASE.half_width,
        coarse=min(2.0, 1.0 / finer), growth=min(0.5, 0.25 / finer),
    )  # fmt: skip


def run(args) -> int:
    """All variants; the exit status."""
    check(args)
    mesh = generate(args.o / "cylinders.msh", args)
    rows, profiles, good = [], [], True
    for theta in THETAS if args.theta is None else (args.theta,):
        row, points, converged = solve(mesh, args, theta, args.o / f"theta{theta:g}")
        good = good and converged
        if converged:
            rows.append(row)
            profiles.append(points)
    if rows:
        report(rows, args)
        plot(args.o / "traction.png", rows, profiles, args.mu)
    keep = ("h", "order", "mu", "gamma0", "displacement", "press", "steps")
    write_json(args.o / "cattaneo_mindlin.json", {**{key: getattr(args, key) for key in keep}, "variants": rows})
    return 0 if good else 1


def make_options():
    """The parser of this driver."""
    parser = make_parser(__doc__, "cattaneo_mindlin_results")
    add = parser.add_argument
    add("--h", type=float, help="element size at the contact (default: half width / 22)")
    add("--order", type=int, choices=(1, 2), default=1, help="degree of displacement and geometry")
    add("--theta", type=float, choices=THETAS, help="variant of Nitsche's method (default: all)")
    add("--gamma0", type=float, help="dimensionless Nitsche parameter")
    add("--mu", type=float, default=0.2, help="coefficient of friction (0.2)")
    add("--displacement", type=float, default=DISPLACEMENT, help="of the upper flat side (that of P = 10)")
    add("--press", type=int, default=20, help="steps that press (20)")
    add("--steps", type=int, default=5, help="steps that shear (5)")
    add("--fields", action="store_true", help="write fields, for pcontact view and ParaView")
    return parser


if __name__ == "__main__":
    main(run, make_options())
