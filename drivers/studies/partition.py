"""Partition: planes that weigh cells and contact against PETSc's graph partitioner, with and without weights.

The meshes of contact scenes in 8 and 64 parts, by the program's own bisection (the default), by bisection that does
not spread contact (``-partition_weight 0``), and by PT-Scotch (or what ``-petscpartitioner_type`` says) with equal
weights and with the bisection's: 1 for a cell, `partition_weight` for each of its facets that may have a partner.
Balance is the largest part over the mean. Shared nodes are the copies of nodes beyond the first, over all nodes. The
parts are found on one rank, and are those that as many ranks would have.
"""

import time as clock

import numpy as np

from drivers._common import main, make_mesh, make_parser, markdown, print_table, write_json
from drivers.studies._graph_parts import graph_parts
from meshes import ball_on_block, dome_on_block, heap, layer_on_base, spring, two_blocks
from pcontact.mesh.partition import WEIGHT, by_bisection, contact_facets
from pcontact.mesh.read import read_mesh
from pcontact.mesh.slices import Corners, whole
from pcontact.mesh.topology import components
from pcontact.runtime.petsc import MPI

# mesh, its arguments (small, large), and the contact pairs
SCENES = {
    "ball on block": (ball_on_block, {"unknowns": 8000}, {"unknowns": 200000}, [("ball_skin", "block_top", None)]),
    "dome on block": (dome_on_block, {"unknowns": 8000}, {"unknowns": 200000}, [("ball_skin", "block_top", None)]),
    "two blocks": (two_blocks, {"dim": 3, "n_lower": 8, "n_upper": 9}, {"dim": 3, "n_lower": 28, "n_upper": 31},
                   [("upper_bottom", "lower_top", None)]),
    "spring": (spring, {"h": 0.7}, {"h": 0.25}, [("skin", "skin", None)]),
    "heap": (heap, {"dim": 3, "count": 8, "h": 0.3}, {"dim": 3, "count": 60, "h": 0.2}, [("skin", "skin", None)]),
    "layer on base": (layer_on_base, {"n": 10}, {"n": 40}, [("layer_bottom", "base_top", None)]),
}  # fmt: skip
BISECTION, GRAPH = ("bisection", "bisection, cells alone"), ("graph", "graph with weights")


def _piece(path):
    """A mesh on this rank alone, as one body."""
    raw = read_mesh(path)
    return whole(MPI.COMM_SELF, raw, False, components(raw))


def _figures(piece, facets, parts, count):
    """Balance of cells, of contact and of work, and shared nodes."""
    work = 1.0 + WEIGHT * facets
    shares = [np.bincount(parts, values, minlength=count) for values in (np.ones(len(parts)), facets, work)]
    copies = sum(len(np.unique(np.column_stack(pair), axis=0)) for pair in _nodes_of_parts(piece, parts))
    nodes = len(np.unique(np.concatenate([block.nodes.ravel() for block in piece.blocks])))
    balance = [float(share.max() / share.mean()) for share in shares]
    keys = ("cells", "contact", "work")
    return dict(zip(keys, balance, strict=True)) | {"shared": (copies - nodes) / nodes}


def _nodes_of_parts(piece, parts):
    """Nodes and their parts, of every kind of cell together."""
    nodes = np.concatenate([block.nodes.ravel() for block in piece.blocks])
    widths = np.concatenate([np.full(len(block.nodes), block.nodes.shape[1]) for block in piece.blocks])
    yield nodes, np.repeat(parts, widths)


def compare(name, path, pairs, counts):
    """Rows of one scene. Not collective."""
    piece = _piece(path)
    facets = contact_facets(piece, Corners(piece), pairs)
    weights = np.round(1.0 + WEIGHT * facets).astype(np.int64)
    ways = {
        BISECTION[0]: lambda count: by_bisection(piece, pairs, WEIGHT, count),
        BISECTION[1]: lambda count: by_bisection(piece, pairs, 0.0, count),
        GRAPH[0]: lambda count: graph_parts(piece, count),
        GRAPH[1]: lambda count: graph_parts(piece, count, weights),
    }
    rows = []
    for count in counts:
        for way, parts_of in ways.items():
            start = clock.perf_counter()
            parts = parts_of(count)
            seconds = clock.perf_counter() - start
            said = {"scene": name, "cells of all": len(piece.ids), "parts": count, "by": way}
            rows.append(said | _figures(piece, facets, parts, count) | {"seconds": seconds})
    return rows


def run(args):
    """The table; 1 where a part is empty or the default leaves a rank more than half as much again."""
    counts = [8] if args.tiny else args.parts
    rows = []
    for name, (mesh, small, large, pairs) in SCENES.items():
        path = make_mesh(mesh, args.o / f"{name.replace(' ', '_')}.msh", **(small if args.tiny else large))
        if MPI.COMM_WORLD.rank == 0:
            rows += compare(name, path, pairs, counts)
    rows = MPI.COMM_WORLD.bcast(rows, root=0)
    print_table("partition", list(rows[0]), [list(row.values()) for row in rows])
    write_json(args.o / "partition.json", {"rows": rows})
    if MPI.COMM_WORLD.rank == 0:
        _write_table(args.o / "partition.md", rows)
    default = [row for row in rows if row["by"] == BISECTION[0]]
    return 0 if all(np.isfinite(row["work"]) and row["work"] < 1.5 for row in default) else 1


def _write_table(path, rows):
    """The table of docs/partition.md."""
    head = ["scene", "cells", "parts", "by", "balance of cells", "of contact", "of work", "shared nodes", "s"]
    table = [[row["scene"], f"{row['cells of all']:,}", row["parts"], row["by"],
              *(f"{row[key]:.2f}" for key in ("cells", "contact", "work")), f"{100 * row['shared']:.1f} %",
              f"{row['seconds']:.2f}"] for row in rows]  # fmt: skip
    path.write_text("\n".join(markdown(head, table)) + "\n")


if __name__ == "__main__":
    parser = make_parser(__doc__, "partition_results")
    parser.add_argument("--parts", type=int, nargs="+", default=[8, 64], help="numbers of parts")
    main(run, parser)
