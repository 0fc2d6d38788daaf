"""A bolted flange with a gasket: eight bolts are tightened, then the pipe is put under pressure.

Two rings of steel (meshes/flange.py), of radii 50 and 110, lie 2 apart, where a gasket fills the gap out to the radius
70: a soft layer, whose pressure is a table. Heads and nuts of eight bolts press on the other sides, with friction. The
bolts are drawn to 40 kN each, locked, and a pressure of 10 acts in the bore, with the force of a closed end on the
upper ring. The pipe below is held. Units: mm, N, MPa.

Rings and bolts are held by contact alone. Statics say what must come out: after tightening the gasket bears the tension
of the bolts, and under pressure the bolts bear the gasket and the end force. How the two share that force says the
joint's stiffness: the printed load factor is the part of the end force that the bolts bear on top of their tension.
"""

import numpy as np

from drivers._common import log, main, make_mesh, make_parser, picture, print_table, running, write_json
from drivers.cases._known import Rows
from meshes.flange import BORE, GAP, flange
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Phase, Pretension, Scene

BOLTS, TENSION, PRESSURE = 8, 40.0e3, 10.0
# force of the closed end of the pipe
END = np.pi * BORE**2 * PRESSURE
# overclosure from the gasket's own thickness on, pressure
GASKET = [[-GAP, 0.0], [-0.95 * GAP, 8.0], [-0.9 * GAP, 30.0], [-0.85 * GAP, 80.0]]
FRICTION, SEALING = 0.15, 0.3


def scene(path, bolts=BOLTS, order=2, fields=False, count=1):
    """The scene on a mesh of :func:`meshes.flange`.

    Parameters
    ----------
    path : mesh file
    bolts : int
    order : int
        Degree of the displacement.
    fields : bool
        Whether fields are written.
    count : int
        Load steps of each phase.
    """
    return Scene(
        title=f"A flange with {bolts} bolts",
        mesh=MeshSpec(path, order=order),
        materials={"steel": Material(210e3, 0.3)},
        bodies=[Body(name, "steel") for name in ("lower", "upper", "bolts")],
        contacts=[
            Contact("upper_gasket", "lower_gasket", name="gasket", friction=SEALING, pressure_overclosure=GASKET),
            Contact("heads", "upper_seat", name="heads", friction=FRICTION),
            Contact("nuts", "lower_seat", name="nuts", friction=FRICTION),
        ],
        displacements=[Displacement("lower_pipe", [0.0, 0.0, 0.0])],
        loads=[
            Load("bore", pressure=PRESSURE, phases=["pressure"]),
            Load("upper_pipe", force=[0.0, 0.0, END], phases=["pressure"]),
        ],
        pretensions=[
            Pretension(f"section_{k}", force=TENSION, name=f"bolt_{k}", phases=["tighten"]) for k in range(1, bolts + 1)
        ],
        phases=[Phase("tighten", count=count), Phase("pressure", count=count)],
        output=Output(fields=fields),
    )


def balance(record, pressed, bolts=BOLTS):
    """Forces of a load step at the end of a phase, and how far they are from balance.

    Returns
    -------
    dict of str to float
        ``bolts``, ``gasket``: sum of tensions, force of the gasket [N]; ``least``, ``most``: of the tensions;
        ``residual``: of the equilibrium of the upper ring along the axis, over the sum of the tensions.
    """
    tensions = np.array([record["pretensions"][f"bolt_{k}"]["force"] for k in range(1, bolts + 1)])
    gasket = abs(record["contacts"]["gasket"]["force"][2])
    off = tensions.sum() - gasket - (END if pressed else 0.0)
    return {"bolts": float(tensions.sum()), "gasket": gasket, "least": float(tensions.min()),
            "most": float(tensions.max()), "residual": float(off / tensions.sum())}  # fmt: skip


def run(args):
    """Both phases; 1 when a load step fails, or forces are not in balance."""
    h, order = (24.0, 1) if args.tiny else (args.h, args.order)
    path = make_mesh(flange, args.o / "flange.msh", h)
    rows = Rows()
    with running(scene(path, order=order, fields=not args.tiny, count=args.count), args.o, [rows]) as (made, converged):
        unknowns = made.problem.space.n_dofs
    if not converged:
        log.error_line("not converged")
        return 1
    ends = {name: [one for one in rows.records if one["phase"] == name][-1] for name in ("tighten", "pressure")}
    found = {name: balance(record, name == "pressure") for name, record in ends.items()}
    share = (found["pressure"]["bolts"] - found["tighten"]["bolts"]) / END
    header = ("phase", *found["tighten"], "largest gasket pressure")
    lines = [(name, *one.values(), ends[name]["contacts"]["gasket"]["max_pressure"]) for name, one in found.items()]
    print_table("flange", header, lines)
    log.info("%d unknowns; load factor of the bolts %.4f", unknowns, share)
    write_json(args.o / "flange.json", {"unknowns": unknowns, "load_factor": share, **found})
    if not args.tiny:
        view = {"field": "equivalent_stress", "output": args.o / "flange.png"}
        on_root(MPI.COMM_WORLD, lambda: picture(args.o, **view))
    return int(max(abs(one["residual"]) for one in found.values()) > 1e-5)


if __name__ == "__main__":
    parser = make_parser(__doc__, "flange_results")
    parser.add_argument("--h", type=float, default=10.4, help="element size of the rings")
    parser.add_argument("--order", type=int, default=2, help="degree of the displacement")
    parser.add_argument("--count", type=int, default=1, help="load steps of each phase")
    main(run, parser)
