"""Errors that are named and reached from coarse meshes whose scenes name their geometry, beside the true ones.

Rings that are shrunk onto each other, four cells in a quarter, with an interference of 1/1000 of their radius; and
spherical shells under pressure. Both have exact solutions (Lame). Without the geometry new nodes lie on the facets of
the first mesh.
"""

import time as clock

from drivers._common import log, main, make_mesh, make_parser, print_table, write_json
from drivers.cases import rings
from drivers.error_norms import bulk_error
from drivers.studies._round_bodies import LARGE, MIDDLE, NU, SMALL, E, round_scene, shell_exact
from meshes import geometries
from meshes import rings as rings_mesh
from meshes.shells import shells
from pcontact.adapt.loop import REACHED, Loop
from pcontact.material.elastic import lame
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.target import Target

DELTA = 6e-4
# name, degree of the mesh, suffix of the geometry
RUNS = (("rings", 2, None), ("rings", 2, ".geo"), ("rings", 2, ".step"), ("rings", 1, None), ("rings", 1, ".geo"),
        ("rings", 1, ".step"), ("shells", 1, ".step"))  # fmt: skip
HEAD = ("scene", "degree of the mesh", "geometry", "reached", "named [%]", "true [%]", "facets, first [%]",
        "facets, last [%]", "degree", "unknowns", "passes", "time [s]")  # fmt: skip


def rings_scene(folder, degree, suffix):
    """The scene of the rings, and what measures the true error of a run."""
    path = make_mesh(rings_mesh, folder / f"rings_{degree}.msh", n=4, cell="triangle", order=degree, delta=DELTA)
    scene = rings.ring_scene(path, 1, 0.0, pressure=0.0)
    if suffix is not None:
        text = geometries.rings(delta=DELTA, kernel="Built-in" if suffix == ".geo" else "OpenCASCADE")
        scene.mesh.geometry = named(folder / f"rings{suffix}", text)
    return scene, lambda simulation: rings.measure(simulation, pressure=0.0, delta=DELTA)["energy"]


def shells_scene(folder, degree, suffix):
    """The same of the shells."""
    path = make_mesh(shells, folder / f"shells_{degree}.msh", (LARGE, MIDDLE, SMALL), h=0.4, order=degree)
    scene = round_scene(path, 1, 0.0, "shells")
    scene.mesh.geometry = named(folder / f"shells{suffix}", geometries.shells((LARGE, MIDDLE, SMALL)))

    def measure(simulation):
        found = bulk_error(simulation.problem.space, [lame(E, NU)] * 2, simulation.stepper.u, shell_exact)
        return found.energy / found.energy_of_exact

    return scene, measure


def named(path, text):
    """Write a geometry; its path, for a scene. *Collective.*"""
    on_root(MPI.COMM_WORLD, geometries.write_geometry, path, text)
    return path.absolute()


def row_of(name, degree, suffix, target, folder):
    """A row of the table. *Collective.*"""
    scene, measure = (rings_scene if name == "rings" else shells_scene)(folder, degree, suffix)
    # the loop chooses it
    scene.mesh.order, scene.accuracy = None, Target(target)
    loop, begun = Loop(scene, take=lambda simulation, _: measure(simulation)), clock.perf_counter()
    outcome = loop.run()
    facets = [sum(part for key, part in one.parts.items() if key.endswith("_facets")) for one in loop.passes]
    first, last = next(part for part in (*facets, 0.0) if part or not any(facets)), loop.passes[-1]
    row = [name, degree, suffix or "none", outcome.status == REACHED, 100.0 * last.error, 100.0 * outcome.kept,
           100.0 * first, 100.0 * facets[-1], last.degree, last.unknowns, len(loop.passes),
           clock.perf_counter() - begun]  # fmt: skip
    log.info("%s", " ".join(str(one) for one in row))
    return row


def run(args):
    """All runs; 0 if those with a geometry reach the target, and their true errors are below those named."""
    runs = RUNS[1:2] if args.tiny else [one for one in RUNS if one[0] in args.scene]
    targets = {"rings": 0.1 if args.tiny else args.target, "shells": args.shells}
    rows = [row_of(*one, targets[one[0]], args.o) for one in runs]
    print_table("errors", HEAD, rows)
    write_json(args.o / "on_geometry.json", {"head": HEAD, "rows": rows})
    return int(not all(row[3] and row[5] < row[4] for row in rows if row[2] != "none"))


def parser():
    """The driver's options."""
    p = make_parser(__doc__, "on_geometry_results")
    p.add_argument("--target", type=float, default=0.02, help="error of the rings (0.02)")
    p.add_argument("--shells", type=float, default=0.03, help="error of the shells (0.03)")
    p.add_argument("--scene", nargs="+", choices=("rings", "shells"), default=["rings", "shells"])
    return p


if __name__ == "__main__":
    main(run, parser())
