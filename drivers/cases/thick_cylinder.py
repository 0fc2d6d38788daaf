"""Hill's thick cylinder: an inner pressure, perfect plasticity, against the closed form, up to the limit load.

A long cylinder (a = 100, b = 200, E = 210, nu = 0.3, yield stress 0.24) in plane strain yields from the inside. With
Y = 2 / sqrt(3) times the yield stress and the plastic zone r < c:

    p = Y (ln(c / a) + (1 - c^2 / b^2) / 2)      pressure of a zone c; first yield at c = a, limit Y ln(b / a) at c = b
    u_r(b) = Y c^2 (1 - nu^2) / (E b)            displacement of the outer face
    r < c:   hoop stress Y (1/2 - ln(c / r) + c^2 / (2 b^2))
    r > c:   hoop stress Y c^2 / (2 b^2) (1 + b^2 / r^2)

Taking the pressure off is elastic below twice the pressure of first yield, and leaves these stresses minus those of
Lame's elastic cylinder (R. Hill, The Mathematical Theory of Plasticity, 1950, chapter 5; E. A. de Souza Neto, D. Peric,
D. R. J. Owen, Computational Methods for Plasticity, 2008, section 7.5.1).

The form takes the axial stress for the mean of the other two, as if elastic volume changes were none in the plastic
zone. That is not so for von Mises and nu = 0.3: fine meshes and load steps do not converge to it but to CONVERGED,
0.47 % more at p = 0.18 and 2.25 % more at 0.19 (strip of 64 and 128 cells of degree 2). It is not the load step: with
1, 2, 8, 32, 80 steps from one pressure to the next the difference at 0.18 is 0.486, 0.481, 0.471, 0.468, 0.467 %, at
0.19 2.41, 2.37, 2.28, 2.26, 2.25 %. With nu = 0.4999 (``--nu``) it is 0.0001 % at 0.18, 0.003 % at 0.19.

Models: a quarter of the section in the plane (quadrilaterals, triangles), a slice of it in space (hexahedra,
tetrahedra), a strip of the meridian with axial symmetry. The limit load is that at which a load step cannot be solved
any more; with axial symmetry the inner face is moved far outwards, and its support force tells the pressure.
"""

from dataclasses import dataclass

import numpy as np

from drivers._common import draw, log, main, make_mesh, make_parser, print_table, running, write_json
from meshes import cylinder_strip, thick_cylinder
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Displacement, Load, Material, MeshSpec, Output, Scene, Steps

PRESSURES = (0.10, 0.12, 0.14, 0.16, 0.18, 0.19)
HEIGHT = 10.0  # along the axis
# u_r(b) with von Mises and nu = 0.3, to about one unit of the last digit: what meshes and load steps converge to
CONVERGED = {0.10: 0.0577778, 0.12: 0.070420, 0.14: 0.087287, 0.16: 0.111644, 0.18: 0.154017, 0.19: 0.20535}
CHECKED = 0.18  # pressure at which the displacement is asked to be right
KINEMATICS = ("plane", "axisymmetric", "space")
CELLS = {
    "plane": ("quadrilateral", "triangle"),
    "axisymmetric": ("quadrilateral", "triangle"),
    "space": ("hexahedron", "tetrahedron"),
}


@dataclass(frozen=True)
class Cylinder:
    """Closed form of a cylinder in plane strain.

    Attributes
    ----------
    a, b : float
        Radii [length].
    E, nu, yield_stress : float
        Elasticity and uniaxial yield stress [stress].
    """

    a: float = 100.0
    b: float = 200.0
    E: float = 210.0
    nu: float = 0.3
    yield_stress: float = 0.24

    @property
    def strength(self) -> float:
        """Y: difference of hoop and radial stress where it yields [stress]."""
        return 2.0 / np.sqrt(3.0) * self.yield_stress

    @property
    def first_yield(self) -> float:
        """Pressure of first yield."""
        return self.pressure(self.a)

    @property
    def limit(self) -> float:
        """Limit pressure."""
        return self.pressure(self.b)

    def pressure(self, c):
        """Pressure of a plastic zone of radius c."""
        return self.strength * (np.log(c / self.a) + 0.5 * (1.0 - (c / self.b) ** 2))

    def front(self, p: float) -> float:
        """Radius c of the plastic zone; not a number above the limit, `a` below first yield."""
        if p > self.limit:
            return float("nan")
        if p <= self.first_yield:
            return self.a
        low, high = self.a, self.b
        while high - low > 1e-13 * self.b:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.pressure(middle) < p else (low, middle)
        return 0.5 * (low + high)

    def displacement(self, p: float, r: float | None = None) -> float:
        """Radial displacement of the outer face; while all is elastic also of any radius (Lame)."""
        if r is None and p > self.first_yield:
            return self.strength * self.front(p) ** 2 * (1.0 - self.nu**2) / (self.E * self.b)
        r = self.b if r is None else r
        factor = p * self.a**2 * (1.0 + self.nu) / (self.E * (self.b**2 - self.a**2))
        return factor * ((1.0 - 2.0 * self.nu) * r + self.b**2 / r)

    def elastic_hoop(self, r, p):
        """Lame's hoop stress."""
        return p * self.a**2 / (self.b**2 - self.a**2) * (1.0 + (self.b / r) ** 2)

    def hoop(self, r, p):
        """Hoop stress under the pressure."""
        if p <= self.first_yield:
            return self.elastic_hoop(r, p)
        c = self.front(p)
        inside = 0.5 - np.log(c / r) + 0.5 * (c / self.b) ** 2
        return self.strength * np.where(r < c, inside, 0.5 * (c / self.b) ** 2 * (1.0 + (self.b / r) ** 2))

    def residual_hoop(self, r, p):
        """Hoop stress that is left when the pressure has gone."""
        return self.hoop(r, p) - self.elastic_hoop(r, p)


def make(path, kinematics, cell, order, n, form=None):
    """The mesh: ``n`` cells across the wall."""
    form = form or Cylinder()
    size = {"inner": form.a, "outer": form.b, "height": 0.1 * form.a}
    if kinematics == "axisymmetric":
        return make_mesh(cylinder_strip, path, (n, max(1, n // 8)), order, cell, **size)
    dim = 3 if kinematics == "space" else 2
    return make_mesh(thick_cylinder, path, dim, (n, max(2, 3 * n // 2)), order, cell, **size)


def scene(path, kinematics, order, table, form=None, steps=2, hardening=0.0, elastic=False, fields=False, petsc=None):
    """Pressure inside, in a number of load steps between the pressures of the table.

    Parameters
    ----------
    path : mesh file of :func:`make`
    kinematics : "plane", "axisymmetric" or "space"
    order : int
        Degree of the displacement.
    table : sequence of float
        Pressures at the times 1, 2, ...
    form : Cylinder, optional
    steps : int
        Load steps from one pressure to the next.
    hardening : float
        [stress]
    elastic : bool
        Never yields.
    fields : bool
        Whether fields are written.
    petsc : dict of str to str, optional
    """
    form = form or Cylinder()
    symmetry = {"plane": 2, "space": 3}.get(kinematics, 0)
    held = [
        Displacement(side, [0.0 if k == axis else "free" for k in range(symmetry)])
        for axis, side in enumerate(("side_x", "side_y"))
        if symmetry
    ]
    if kinematics == "space":
        held += [Displacement(side, ["free", "free", 0.0]) for side in ("front", "back")]
    if kinematics == "axisymmetric":
        held += [Displacement(side, ["free", 0.0]) for side in ("bottom", "top")]
    law = {} if elastic else {"yield_stress": form.yield_stress, "hardening": hardening}
    return Scene(
        title=f"Thick cylinder, {kinematics}, degree {order}",
        mesh=MeshSpec(path, order, "axisymmetric" if kinematics == "axisymmetric" else "plane_strain"),
        materials={"metal": Material(form.E, form.nu, **law)},
        bodies=[Body("body", "metal")],
        displacements=held,
        loads=[Load("inner", pressure=1.0, amplitude=[(0.0, 0.0), *((k + 1.0, p) for k, p in enumerate(table))])],
        steps=Steps(float(len(table)), len(table) * steps),
        output=Output(fields=fields, probes=["inner", "outer"]),
        petsc=petsc or {},
    )


class Curve(Observer):
    """Observer: rows (a dict per load step) of pressure and displacements.

    Parameters
    ----------
    pressure : callable
        Of time and the step's record.
    """

    def __init__(self, pressure):
        self.rows, self._pressure = [], pressure

    def step(self, step, u, record):
        """Keep the step's numbers."""
        # the largest x of a round face is that of its node on y = 0
        outward = {side: record["probes"][side]["max"][0] for side in ("inner", "outer")}
        row = {"time": step.time, "pressure": float(self._pressure(step.time, record)), **outward, **record["plastic"]}
        self.rows.append({**row, "newton": step.newton, "krylov": step.krylov, "cutbacks": step.cutbacks})


def cell_hoop(simulation):
    """Radius of the middle, mean hoop stress and volume of all cells on rank 0, by radius. *Collective.*"""
    problem, mesh, parts = simulation.problem, simulation.mesh, []
    for block, (stress, volume) in zip(mesh.blocks, problem.items[0].stress(simulation.stepper.u), strict=True):
        x = mesh.points[block.nodes].mean(axis=1)
        if problem.space.axisymmetric:
            parts.append(np.column_stack([x[:, 0], stress[:, 2], volume]))
            continue
        # nodes of a quarter: the direction of the middle is right, its distance from the axis a little short
        r, (c, s) = np.hypot(x[:, 0], x[:, 1]), x[:, :2].T / np.hypot(x[:, 0], x[:, 1])
        hoop = s * s * stress[:, 0] + c * c * stress[:, 1] - 2.0 * s * c * stress[:, 3]
        parts.append(np.column_stack([r, hoop, volume]))
    gathered = simulation.comm.gather(np.concatenate(parts), root=0)
    if gathered is None:
        return None
    table = np.concatenate(gathered)
    return table[np.argsort(table[:, 0])]


def at_pressures(rows, pressures):
    """The first row at each pressure; None where the run did not get there."""
    found = [[row for row in rows if abs(row["pressure"] - p) < 1e-9 * p] for p in pressures]
    return [some[0] if some else None for some in found]


def load_and_unload(args, path, form):
    """Loading in the steps of the table, unloading: converged, rows, residual hoop stress on rank 0. *Collective.*"""
    table = [*args.pressures, 0.0]
    corners = np.array([0.0, *table])
    curve = Curve(lambda time, record: np.interp(time, np.arange(len(corners)), corners))
    case = scene(path, args.kinematics, args.order, table, form, args.steps, args.hardening, fields=not args.tiny)
    with running(case, args.o / "load", [curve]) as (simulation, converged):
        return converged, curve.rows, cell_hoop(simulation) if converged else None


def limit_by_pressure(args, path, form):
    """Rows while the pressure rises from 0.95 of the limit on, until the smallest load step fails. *Collective.*"""
    table = [form.first_yield, 0.95 * form.limit, 1.25 * form.limit]
    corners = np.array([0.0, *table])
    curve = Curve(lambda time, record: np.interp(time, np.arange(len(corners)), corners))
    # the failure is what is looked for, and few iterations tell
    case = scene(path, args.kinematics, args.order, table, form, 15, petsc={"snes_max_it": "25"})
    case.steps.min_step = 1e-3
    log.info("the limit load: the pressure rises until no load step can be solved, however small")
    with running(case, None, [curve]) as (_, converged):
        if converged:
            log.info("no limit load up to %g", table[-1])
    return curve.rows


def limit_by_displacement(args, path, form):
    """Rows while the inner face of the strip moves far outwards; the support force is the pressure. *Collective.*"""
    far = 10.0 * form.strength * form.b / form.E
    area = 2.0 * np.pi * form.a * 0.1 * form.a
    curve = Curve(lambda time, record: record["reactions"]["inner"][0] / area)
    case = scene(path, args.kinematics, args.order, [0.0], form)
    case.loads = []
    case.displacements.append(Displacement("inner", [far, "free"]))
    case.steps = Steps(1.0, 40)
    with running(case, None, [curve]):
        return curve.rows


def lame(args):
    """Elastic, a = 10 mm, b = 20 mm, E = 210 GPa, 100 MPa: u_r(a), hoop stress at a and b, beside the closed form.

    The hoop stresses of the cells are fitted with A + B / r^2. *Collective.*
    """
    form, pressure = Cylinder(10.0, 20.0, 210e3, 0.3, 1e9), 100.0
    path = make(args.o / "lame.msh", args.kinematics, args.cell, args.order, args.n, form)
    curve = Curve(lambda time, record: pressure * time)
    case = scene(path, args.kinematics, args.order, [pressure], form, 1, elastic=True)
    with running(case, None, [curve]) as (simulation, _):
        cells = simulation.comm.bcast(cell_hoop(simulation))
    powers = np.column_stack([np.ones(len(cells)), cells[:, 0] ** -2.0])
    weight = np.sqrt(cells[:, 2])
    constant, slope = np.linalg.lstsq(powers * weight[:, None], cells[:, 1] * weight, rcond=None)[0]
    found = [curve.rows[-1]["inner"], constant + slope / form.a**2, constant + slope / form.b**2]
    exact = [form.displacement(pressure, form.a), *(float(form.elastic_hoop(r, pressure)) for r in (form.a, form.b))]
    names = ["u_r(a) [mm]", "hoop stress at a [MPa]", "hoop stress at b [MPa]"]
    rows = [[*row, _percent(*row[1:])] for row in zip(names, found, exact, strict=True)]
    print_table("elastic cylinder, Lame", ["", "computed", "closed form", "difference %"], rows)
    return dict(zip(("inner", "hoop_a", "hoop_b"), zip(found, exact, strict=True), strict=True))


def _percent(value, reference):
    return 100.0 * (value / reference - 1.0)


def compare(form, rows, pressures):
    """Rows of a table: pressure, computed u_r(b), closed form, difference in percent from it and from CONVERGED, c."""
    table, known = [], CONVERGED if form == Cylinder() else {}
    for p, row in zip(pressures, at_pressures(rows, pressures), strict=True):
        if row is not None:
            exact = form.displacement(p)
            numbers = {"pressure": p, "computed": row["outer"], "closed": exact}
            numbers |= {"percent": _percent(row["outer"], exact), "front": form.front(p)}
            numbers["of_converged"] = _percent(row["outer"], known.get(p, float("nan")))
            table.append({**numbers, "newton": row["newton"], "cutbacks": row["cutbacks"]})
    return table


def _plot(form, rows, last, limit_rows, hoop, hardening):
    """Displacement curve, limit load, residual stress."""

    def paint(axes):
        p = np.linspace(0.0, 0.9999 * form.limit, 300)
        axes[0].plot([form.displacement(value) for value in p], p, "k-", lw=0.8, label="closed form (no hardening)")
        points = np.array([[0.0, 0.0], *([row["outer"], row["pressure"]] for row in rows)])
        axes[0].plot(*points.T, "o-", ms=3, color="#c8553d", label="computed")
        axes[0].axhline(form.limit, color="k", ls=":", lw=0.8)
        axes[0].set(xlabel="displacement of the outer face", ylabel="pressure")
        if limit_rows:
            x, y = np.array([[row["inner"], row["pressure"]] for row in limit_rows]).T
            axes[1].plot(x, y / form.limit, "o-", ms=3, color="#c8553d", label="computed")
            axes[1].axhline(1.0, color="k", ls=":", lw=0.8, label="limit")
        axes[1].set(xlabel="displacement of the inner face", ylabel="pressure / limit")
        if hoop is not None:
            r = np.linspace(form.a, form.b, 300)
            text = "closed form" + (" (no hardening)" if hardening else "")
            axes[2].plot(r, form.residual_hoop(r, last), "k-", lw=0.8, label=text)
            axes[2].plot(hoop[:, 0], hoop[:, 1], ".", ms=4, color="#c8553d", label="cells")
        axes[2].set(xlabel="radius", ylabel=f"hoop stress after {last:g}")
        for ax in axes:
            ax.grid(alpha=0.3)
            if ax.has_data():
                ax.legend(fontsize="small")

    return paint


def residual_error(form, hoop, pressure):
    """Largest and mean difference of the hoop stress from the closed form, over the yield stress (rank 0)."""
    if hoop is None:
        return None
    gap = np.abs(hoop[:, 1] - form.residual_hoop(hoop[:, 0], pressure)) / form.yield_stress
    return {"largest": float(gap.max()), "mean": float(np.average(gap, weights=hoop[:, 2]))}


def limit_load(args, path, form):
    """Limit load, its difference in percent, and the rows of the run; None with hardening. *Collective.*"""
    if args.hardening:
        return None, []
    runs = {"axisymmetric": limit_by_displacement}.get(args.kinematics, limit_by_pressure)
    rows = runs(args, path, form)
    found = max(row["pressure"] for row in rows)
    percent = _percent(found, form.limit)
    table = [[found, form.limit, percent, sum(row["newton"] for row in rows)]]
    print_table("limit load", ["computed", "closed form", "difference %", "newton"], table)
    return {"computed": found, "closed": form.limit, "percent": percent}, rows


def run(args):
    """Loading, unloading, limit load; 1 when a step fails or a number is not as asked for."""
    args.cell = args.cell or CELLS[args.kinematics][0]
    if args.lame:
        write_json(args.o / "lame.json", lame(args))
        return 0
    form = Cylinder(nu=args.nu)
    args.n = 4 if args.tiny else args.n
    path = make(args.o / "cylinder.msh", args.kinematics, args.cell, args.order, args.n, form)
    converged, rows, hoop = load_and_unload(args, path, form)
    table = compare(form, rows, args.pressures)
    title = f"thick cylinder, {args.kinematics}, {args.cell}, degree {args.order}, {args.n} cells, nu {args.nu:g}"
    columns = ["pressure", "computed", "closed", "percent", "of_converged", "front", "newton", "cutbacks"]
    header = ["p", "computed", "closed form", "difference %", "of converged %", "c", "newton", "cutbacks"]
    print_table(f"{title}: u_r(b)", header, [[row[key] for key in columns] for row in table])
    residual = MPI.COMM_WORLD.bcast(residual_error(form, hoop, args.pressures[-1]))
    if residual is not None:
        header = ["largest", "mean"]
        print_table("residual hoop stress: difference / yield stress", header, [[residual[key] for key in header]])
    limit, limit_rows = (None, []) if args.no_limit else limit_load(args, path, form)
    draw(args.o / "cylinder.png", _plot(form, rows, args.pressures[-1], limit_rows, hoop, args.hardening), columns=3)
    keep = ("kinematics", "cell", "order", "n", "nu", "hardening", "steps")
    data = {**{key: getattr(args, key) for key in keep}, "first_yield": form.first_yield, "table": table}
    data |= {"residual": residual, "limit": limit, "rows": rows, "limit_rows": limit_rows, "converged": converged}
    write_json(args.o / "cylinder.json", data)
    return 0 if converged and good(args, table, limit) else 1


def good(args, table, limit):
    """Whether the numbers are as asked for, where they have to be: not with hardening, nor with cells that lock.

    The displacement may be near the closed form or near what it converges to.
    """
    if args.tiny or args.hardening or (args.order == 1 and args.cell in ("triangle", "tetrahedron")):
        return True
    checked = [row for row in table if row["pressure"] == CHECKED]
    near = all(abs(row["percent"]) < 0.5 or abs(row["of_converged"]) < 0.5 for row in checked)
    return near and (limit is None or abs(limit["percent"]) < 1.0)


def make_options():
    """The parser of this driver."""
    parser = make_parser(__doc__, "thick_cylinder_results")
    add = parser.add_argument
    add("--kinematics", choices=KINEMATICS, default="plane", help="quarter of the section, strip, or slice (plane)")
    add("--cell", choices=sorted(set(sum(CELLS.values(), ()))), help="kind of cells (quadrilateral, hexahedron)")
    add("--order", type=int, choices=(1, 2), default=1, help="degree of displacement and geometry")
    add("--n", type=int, default=16, help="cells across the wall (16)")
    add("--nu", type=float, default=0.3, help="Poisson's ratio (0.3)")
    add("--hardening", type=float, default=0.0, help="isotropic hardening (0)")
    add("--pressures", type=float, nargs="+", default=list(PRESSURES), help="of the table; then the load is taken off")
    add("--steps", type=int, default=2, help="load steps from one pressure to the next (2)")
    add("--no_limit", action="store_true", help="leave out the limit load")
    add("--lame", action="store_true", help="only the elastic cylinder of Lame")
    return parser


if __name__ == "__main__":
    main(run, make_options())
