"""A pinned joint: a lug is pulled out of a fork, whose pin has play in its holes.

The half z >= 0 (meshes/pin.py): a lug of thickness 20 between the cheeks of a fork, 10 thick each, a pin of the radius
15 through both. The play is 0.05 wherever pin and holes face each other, by `clearance`: in the mesh they touch. The
end of the fork is held, that of the lug is pulled by 20 kN (10 kN on the half). Friction 0.1. Units: mm, N, MPa.

Lug and pin are held by contact alone, and touch nothing at first. Statics say that the pin bears 10 kN from each side.
"""

import numpy as np

from drivers._common import log, main, make_mesh, make_parser, picture, print_table, running, write_json
from drivers.cases._known import Rows
from meshes.pin import pin
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene, Steps

FORCE, PLAY, FRICTION = 10.0e3, 0.05, 0.1


def scene(path, order=2, fields=False, count=1):
    """The scene on a mesh of :func:`meshes.pin`.

    Parameters
    ----------
    path : mesh file
    order : int
        Degree of the displacement.
    fields : bool
        Whether fields are written.
    count : int
        Load steps.
    """
    return Scene(
        title="A pinned joint",
        mesh=MeshSpec(path, order=order),
        materials={"steel": Material(210e3, 0.3)},
        bodies=[Body(name, "steel") for name in ("lug", "fork", "shaft")],
        contacts=[
            Contact(f"{name}_hole", "shaft_skin", name=name, friction=FRICTION, clearance=PLAY)
            for name in ("lug", "fork")
        ],
        displacements=[
            Displacement("fork_end", [0.0, 0.0, 0.0]), Displacement("symmetry_z", ["free", "free", 0.0]),
        ],
        loads=[Load("lug_end", force=[-FORCE, 0.0, 0.0])],
        steps=Steps(count=count),
        output=Output(fields=fields, probes=["lug_end"]),
    )  # fmt: skip


def balance(record):
    """Forces of lug and fork on the pin along the joint [N], and what is out of balance over the load."""
    lug, fork = (np.array(record["contacts"][name]["force"]) for name in ("lug", "fork"))
    off = max(abs(lug[0] + FORCE), abs(fork[0] - FORCE), abs(lug[1]), abs(fork[1]))
    return {"lug": float(lug[0]), "fork": float(fork[0]), "residual": float(off / FORCE)}


def run(args):
    """The load steps; 1 when one fails, or forces are not in balance."""
    h, order = (12.0, 1) if args.tiny else (args.h, args.order)
    path = make_mesh(pin, args.o / "pin.msh", h, order)
    rows = Rows()
    with running(scene(path, order, not args.tiny, args.count), args.o, [rows]) as (made, converged):
        unknowns = made.problem.space.n_dofs
    if not converged:
        log.error_line("not converged")
        return 1
    found, last = balance(rows.records[-1]), rows.records[-1]
    way = last["probes"]["lug_end"]["mean"][0]
    pressures = [last["contacts"][name]["max_pressure"] for name in ("lug", "fork")]
    print_table("pinned joint", (*found, "way of the lug", "pressure, lug", "pressure, fork"),
                [(*found.values(), way, *pressures)])  # fmt: skip
    log.info("%d unknowns", unknowns)
    write_json(args.o / "pinned_joint.json", {"unknowns": unknowns, "way": way, "pressures": pressures, **found})
    if not args.tiny:
        view = {"field": "equivalent_stress", "output": args.o / "pinned_joint.png"}
        on_root(MPI.COMM_WORLD, lambda: picture(args.o, **view))
    return int(found["residual"] > 1e-5)


if __name__ == "__main__":
    parser = make_parser(__doc__, "pinned_joint_results")
    parser.add_argument("--h", type=float, default=6.0, help="element size of the plates")
    parser.add_argument("--order", type=int, default=2, help="degree of mesh and displacement")
    parser.add_argument("--count", type=int, default=1, help="load steps")
    main(run, parser)
