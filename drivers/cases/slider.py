"""The sliding block: stick, slide, reverse, stick, slide back.

An elastic block lies on a rigid plane, is pressed down and then dragged along it by its top: forth, back to the
other side, and to the middle. It sticks while the tangential force is below what the law of friction bears, and
slides with exactly that force afterwards, whatever the shape of the pressure:

    coulomb   mu N                          tresca    s A, whatever N
    capped    mu N, at most s A             adhesion  mu N + c A

with N the normal force, A the area of the block. The slope of the loop where it sticks is that of the block. The
block is pressed by a pressure on its top, or its top is held flat at a height (``--hold flat``; a high block with
much friction would tip otherwise).
"""

import numpy as np

from drivers._common import draw, main, make_mesh, make_parser, print_table, running, write_json
from meshes import one_block
from pcontact.runtime.observer import Observer
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene, Steps

E_MODULUS, NU, PRESSURE = 1000.0, 0.3, 10.0
HEIGHT = 0.1  # length and width of the block are 1
BOND, CAP = 1.0, 1.5  # adhesion c and tresca bound; cap s
LAWS = ("coulomb", "tresca", "capped", "adhesion")
# press, then forth, back and to the middle: (time, drag)
DRAG = [(0.0, 0.0), (0.2, 0.0), (0.4, 1.0), (0.8, -1.0), (1.0, 0.0)]
PRESS = [(0.0, 0.0), (0.2, 1.0), (1.0, 1.0)]


def law_keys(law, mu):
    """Keys of :class:`pcontact.scene.model.Contact` that make a law, and the same for :func:`bound`."""
    return {
        "coulomb": {"friction": mu},
        "tresca": {"tresca": BOND},
        "capped": {"friction": mu, "friction_limit": CAP},
        "adhesion": {"friction": mu, "adhesion": BOND},
    }[law]


def bound(keys, normal, area):
    """Largest tangential force: (normal force, area) as in the module's table.

    With a cap this holds where all points are below it, or all above.
    """
    if "tresca" in keys:
        return keys["tresca"] * area
    force = keys["friction"] * normal + keys.get("adhesion", 0.0) * area
    return min(force, keys.get("friction_limit", np.inf) * area)


def scene(path, dim, keys, drag=0.002, hold="pressure", count=40, guided=True, fields=False, petsc=None, **contact):
    """The scene on a mesh of :func:`make`.

    Parameters
    ----------
    path : mesh file
    dim : int
    keys : dict
        See :func:`law_keys`.
    drag : float
        Largest displacement of the top [length].
    hold : "pressure" or "flat"
    count : int
        Load steps.
    guided : bool
        In space: the sides along the way stay plane. Otherwise the pressed block bulges, and is rubbed back to its
        shape while it slides: only then does all of the friction act along the way.
    fields : bool
        Whether fields are written.
    petsc : dict of str to str, optional
    contact : further keys of :class:`pcontact.scene.model.Contact`
    """
    across = [0.0] * (dim - 2)
    up = np.eye(dim)[-1].tolist()
    case = Scene(
        title=f"Sliding block, {dim}D, {keys}",
        mesh=MeshSpec(path),
        materials={"elastic": Material(E_MODULUS, NU)},
        bodies=[Body("block", "elastic")],
        contacts=[
            Contact("bottom", obstacle=Obstacle("plane", point=[0.0] * dim, normal=up), name="floor", **keys, **contact)
        ],
        displacements=[Displacement("top", [drag, *across, "free"], DRAG)],
        steps=Steps(count=count),
        output=Output(fields=fields, probes=["top"]),
        petsc={"snes_rtol": "1e-10", **(petsc or {})},
    )
    if dim == 3 and guided:
        case.displacements += [Displacement(side, ["free", 0.0, "free"]) for side in ("front", "back")]
    if hold == "flat":
        depth = PRESSURE / E_MODULUS * HEIGHT
        case.displacements.append(Displacement("top", [*["free"] * (dim - 1), -depth], PRESS))
    else:
        case.loads.append(Load("top", pressure=PRESSURE, amplitude=PRESS))
    return case


def make(path, dim, n, cell=None):
    """The mesh: ``n`` cells along the block, a quarter of it upwards."""
    upward = max(1, n // 4)
    divisions = [n, upward] if dim == 2 else [n, n, upward]
    return make_mesh(one_block, path, dim, divisions, cell, size=[*[1.0] * (dim - 1), HEIGHT])


class Loop(Observer):
    """Observer: rows (a dict per load step) of the force on the plane and of its bound.

    Parameters
    ----------
    keys : dict
        See :func:`law_keys`.
    """

    def __init__(self, keys):
        self.keys, self.rows = keys, []

    def step(self, step, u, record):
        """Keep the step's numbers."""
        floor = record["contacts"]["floor"]
        # force is that on the plane, dragged along by the block
        row = {"time": step.time, "drag": record["probes"]["top"]["mean"][0], "force": floor["force"][0]}
        row["normal"] = -floor["force"][-1]
        row["bound"] = bound(self.keys, row["normal"], 1.0)
        names = ("open", "stick", "slip")
        counts = {"newton": step.newton, "krylov": step.krylov, "cutbacks": step.cutbacks}
        self.rows.append({**row, **{name: floor[name] for name in names}, **counts})


def sliding(rows):
    """Rows in which every closed point slips, the steps after which the force is the bound."""
    return [row for row in rows if row["stick"] == 0 and row["slip"] > 0 and row["time"] > DRAG[1][0]]


def _plot(rows, title):
    def paint(axes):
        moved = [row for row in rows if row["time"] >= DRAG[1][0]]
        for ax, part, key, text in (
            (axes[0], rows, "time", "time"),
            (axes[1], moved, "drag", "displacement of the top"),
        ):
            x, force, limit = (np.array([row[name] for row in part]) for name in (key, "force", "bound"))
            ax.plot(x, force, "o-", ms=3, label="tangential force")
            order = np.argsort(x, kind="stable")
            for sign in (1, -1):
                ax.plot(x[order], sign * limit[order], "k--", lw=0.8, label="bound" if sign > 0 else None)
            ax.set_xlabel(text)
            ax.locator_params(axis="x", nbins=5)
            ax.grid(alpha=0.3)
        axes[0].set_ylabel("tangential force")
        axes[0].legend(fontsize="small", loc="lower left")
        axes[1].set_title(title, fontsize="small")

    return paint


def run(args):
    """One loop for every dimension; 1 when a step fails, or the force of sliding is not the bound."""
    keys, data, good = law_keys(args.law, args.mu), {}, True
    for dim in [2] if args.tiny else args.dim:
        name = f"{args.law}_{dim}d"
        path = make(args.o / f"{name}.msh", dim, 4 if args.tiny else args.n)
        loop = Loop(keys)
        case = scene(path, dim, keys, args.drag, args.hold, args.count, not args.free, not args.tiny, theta=args.theta)
        with running(case, args.o / name, [loop]) as (_, converged):
            rows = loop.rows
        columns = ["time", "drag", "force", "bound", "normal", "open", "stick", "slip", "newton", "cutbacks"]
        title = f"{dim}D, {args.law}, mu {args.mu:g}, theta {args.theta:g}"
        print_table(f"sliding block, {title}", columns, [[row[k] for k in columns] for row in rows])
        errors = [abs(abs(row["force"]) / row["bound"] - 1.0) for row in sliding(rows)]
        print_table("sliding steps: largest relative difference of force and bound",
                    ["steps", "difference"], [[len(errors), max(errors, default=float("nan"))]])  # fmt: skip
        draw(args.o / f"{name}.png", _plot(rows, title), columns=2)
        # a cap may hold some points only, and free sides take part of the friction
        exact = args.law != "capped" and not args.free
        good = good and converged and bool(errors) and (max(errors) < 1e-6 or not exact)
        data[name] = {"rows": rows, "converged": converged, "largest_difference": max(errors, default=None)}
    write_json(args.o / "slider.json", data)
    return 0 if good else 1


if __name__ == "__main__":
    parser = make_parser(__doc__, "slider_results")
    parser.add_argument("--dim", type=int, nargs="+", default=[2, 3], choices=[2, 3], help="dimensions")
    parser.add_argument("--mu", type=float, default=0.3, help="coefficient of friction")
    parser.add_argument("--theta", type=float, default=0.0, choices=[1.0, 0.0, -1.0], help="variant of the method")
    parser.add_argument("--law", default="coulomb", choices=LAWS, help="law of friction")
    parser.add_argument("--hold", default="pressure", choices=["pressure", "flat"], help="how the top is held")
    parser.add_argument("--free", action="store_true", help="in space: the sides may bulge")
    parser.add_argument("--drag", type=float, default=0.002, help="largest displacement of the top")
    parser.add_argument("--n", type=int, default=8, help="cells along the block")
    parser.add_argument("--count", type=int, default=40, help="load steps")
    main(run, parser)
