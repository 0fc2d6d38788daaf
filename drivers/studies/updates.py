"""Updates of multipliers (augmented Lagrangian): a source and a target, and unbiased contact in two ways.

Every scene runs three times: with a source and a target, and as unbiased contact, where an update takes the mean over
the points of both surfaces, or, to see what that is good for, over those of each surface alone. Flat blocks of unlike
width whose meshes do not match, pressed and dragged; a cylinder on a block (Hertz) and a disk on one; concentric rings;
a ring whose lips meet, and disks in a box (self contact and contact of all surfaces have no source and target).
Columns: degree of the displacement, friction; updates of the load step that took most of them (in brackets what they
still changed, if that is more than 1e-4) and the largest pressure at the end, for each of the three.
"""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from itertools import product
from pathlib import Path

from drivers._common import main, make_mesh, make_parser, markdown, print_table, running, write_json
from drivers.cases import disk_on_block, patch, rings, stack
from drivers.cases.hertz import generate
from drivers.studies import compare
from drivers.studies._harness import Counts, composed
from meshes import c_strip, heap, two_blocks
from meshes import disk_on_block as disk_mesh
from meshes import rings as ring_mesh
from pcontact.contact.formulation import methods
from pcontact.scene.model import Contact, Load, Material, MeshSpec, Scene, Steps

AUGMENTED, SETTLED = "augmented_lagrangian", 1e-4
VARIANTS = ("source and target", "each alone", "both")
COLUMNS = ("scene", "degree", "friction", *(f"{what}, {name}" for what in ("updates", "pressure") for name in VARIANTS))


@contextmanager
def each_alone() -> Iterator[None]:
    """An update takes the mean over the points of each surface alone."""
    kept, methods.is_unbiased = methods.is_unbiased, lambda contact: False
    try:
        yield
    finally:
        methods.is_unbiased = kept


def flat(directory: Path, cell: str, order: int) -> Scene:
    """Blocks of widths 1 and 0.6, the upper one pressed and dragged."""
    dim, n = (2, (4, 6)) if cell in ("triangle", "quadrilateral") else (3, (2, 3))
    path = make_mesh(two_blocks, directory / f"{cell}.msh", dim, *n, cell, widths=(1.0, 0.6))
    case = patch.scene(path, dim, order)
    case.displacements = case.displacements[:2]
    case.displacements[0].value = [0.0] * dim
    case.displacements[1].value = [0.05, *[0.0] * (dim - 2), -patch.PUSH]
    case.materials["elastic"].nu, case.petsc = 0.3, {}
    return case


def cylinder(directory: Path, order: int) -> Scene:
    """A cylinder on a block, 5 or 3 facets in the half width of the contact."""
    h = compare.CASE.half_width / (5 if order == 1 else 3)
    path = generate(compare.CASE, directory / f"cylinder_{order}.msh", h, order)
    return compare.make_scene(path, "augmented", 1.0, order)


def disk(directory: Path, order: int) -> Scene:
    """A disk under its weight on a block, in two load steps."""
    path = make_mesh(disk_mesh, directory / f"disk_{order}.msh", h=0.05, order=order)
    case = disk_on_block.scene(path, 0.0, order=order)
    case.steps, case.petsc = Steps(count=2), {}
    return case


def circles(directory: Path, order: int) -> Scene:
    """Concentric rings on meshes of degree 2, pressed from outside."""
    return rings.ring_scene(make_mesh(ring_mesh, directory / "rings.msh", n=8, order=2), order, 0.0, gamma0=None)


def lips(directory: Path, order: int) -> Scene:
    """An open ring that is pressed from outside until its lips meet, in three load steps."""
    path = make_mesh(c_strip, directory / "strip.msh", (3, 24), 1, "quadrilateral", gap=2.0)
    return composed(
        MeshSpec(path, order=order),
        {"strip": Material(1000.0, 0.3)},
        {"back": [0.0, 0.0]},
        contacts=[Contact("skin", "skin", name="lips", search_radius=1.0)],
        loads=[Load("strip_outer", pressure=1.2)],
        steps=Steps(count=3),
    )


def disks(directory: Path, order: int) -> Scene:
    """Five loose disks in a box with a plate that comes down, in two load steps."""
    path = make_mesh(heap, directory / "heap.msh", 2, 5, 0.3, 0.0, overlap=0.03)
    return stack.scene(path, 2, 5, steps=2, order=order, overlap=0.03)


# what makes a scene in a directory, for a degree of the displacement
SCENES = {
    "flat blocks, quadrilaterals": partial(flat, cell="quadrilateral"),
    "flat blocks, tetrahedra": partial(flat, cell="tetrahedron"),
    "cylinder on block": cylinder,
    "disk on block": disk,
    "rings": circles,
    "lips of a ring": lips,
    "disks in a box": disks,
}


def solve(case: Scene, variant: str, friction: float) -> dict | None:
    """One run, None where there is no such variant. *Collective.*"""
    contact = case.contacts[0]
    alike = contact.all or contact.source == contact.target
    if alike and variant == VARIANTS[0]:
        return None
    for one in case.contacts:
        one.formulation, one.friction = AUGMENTED, friction
    contact.unbiased = variant != VARIANTS[0] and not alike
    watch = Counts()
    with each_alone() if variant == VARIANTS[1] else nullcontext(), running(case, None, [watch]) as (_, converged):
        pass
    if not converged:
        return {"updates": float("nan"), "change": float("nan"), "newton": float("nan"), "pressure": float("nan")}
    most = max((record["uzawa"] for record in watch.records), key=lambda uzawa: uzawa["updates"])
    newton = sum(record["newton"] for record in watch.records)
    pressure = next(iter(watch.records[-1]["contacts"].values()))["max_pressure"]
    return {**most, "newton": newton, "pressure": pressure}


def cells(row: dict) -> list:
    """Return the cells that a table shows of a scene."""
    found = [row[name] for name in VARIANTS]
    updates = ["" if one is None else f"{one['updates']}" for one in found]
    for k, one in enumerate(found):
        updates[k] += f" ({one['change']:.0e})" if one is not None and not one["change"] <= SETTLED else ""
    pressure = ["" if one is None else f"{one['pressure']:.3g}" for one in found]
    return [row["scene"], row["degree"], row["friction"], *updates, *pressure]


def run(args) -> int:
    """All scenes; 1 where multipliers of unbiased contact do not settle."""
    rows, names = [], list(SCENES)[:1] if args.tiny else args.scenes
    for name, order, friction in product(names, (1,) if args.tiny else (1, 2), args.friction):
        row = {"scene": name, "degree": order, "friction": friction}
        for variant in VARIANTS:
            row[variant] = solve(SCENES[name](args.o, order=order), variant, friction)
        rows.append(row)
    table = [cells(row) for row in rows]
    print_table("updates of multipliers", COLUMNS, table)
    write_json(args.o / "updates.json", {"rows": rows, "markdown": markdown(COLUMNS, table)})
    return 0 if all(row[VARIANTS[2]]["change"] <= SETTLED for row in rows) else 1


def make_options():
    """The parser of this driver."""
    parser = make_parser(__doc__, "updates_results")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES), help="which")
    parser.add_argument("--friction", type=float, nargs="+", default=[0.0, 0.3], help="coefficients of friction")
    return parser


if __name__ == "__main__":
    main(run, make_options())
