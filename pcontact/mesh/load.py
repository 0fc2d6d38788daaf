"""From a mesh file to one mesh per rank."""

import numpy as np

from pcontact.mesh.complete import complete, without_middles
from pcontact.mesh.components import cell_name, components
from pcontact.mesh.distribute import deal
from pcontact.mesh.groups import facet_multiplicity, say_lost
from pcontact.mesh.hdf5_reader import ConvertedMesh, is_converted
from pcontact.mesh.partition import WEIGHT
from pcontact.mesh.reader import read_mesh
from pcontact.mesh.slices import whole
from pcontact.runtime import profile
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import agree, on_root, together
from pcontact.runtime.petsc import MPI


def _refuse(piece, rows, message):
    """Raise an InputError about the first of the rows of all ranks and their number, if there are any."""
    total = piece.comm.allreduce(len(rows))
    if total:
        agree(piece.comm, message(int(rows[0]), total) if len(rows) else None)


def _set_bodies(piece, regions, named):
    """Give the cells their bodies, numbers of cell groups; a cell in no body or in two is an error. *Collective.*"""
    body = np.full(len(piece.ids), -1, dtype=np.int64)
    for number, region in enumerate(regions):
        cells = piece.cell_groups[region]
        _refuse(piece, cells[body[cells] >= 0], lambda row, n, region=region: (
            f"{piece.path}: {named(row)} of body {region!r} is also in body {regions[body[row]]!r} ({n} in all); "
            "allowed: every cell in one body"
        ))  # fmt: skip
        body[cells] = number

    def homeless(row, n):
        names = [name for name, cells in piece.cell_groups.items() if np.isin(row, cells)]
        where = f"of group {names[0]!r}" if names else "of no group"
        return (f"{piece.path}: {named(row)} {where} is in no body ({n} in all); "
                "allowed: every cell in the region of one of the [[bodies]]")  # fmt: skip

    _refuse(piece, np.flatnonzero(body < 0), homeless)
    piece.body = body


def _check_surfaces(piece, between, named):
    """Refuse contact surfaces with facets between two cells: bool (n,) of those of each surface. *Collective.*"""
    for name, inside in between.items():
        _refuse(piece, piece.facet_groups[name][0][inside], lambda row, n, name=name: (
            f"{piece.path}: contact surface {name!r} has {n} facets between two cells, the first one at {named(row)}; "
            "allowed: facets on the boundary of a body (bodies in contact must not share nodes)"
        ))  # fmt: skip


def _component_names(piece, regions):
    """Body, or bodies, of every connected component. *Collective.*"""
    there = np.zeros((piece.n_components, len(regions)), dtype=bool)
    there[piece.component, piece.body] = True
    piece.comm.Allreduce(MPI.IN_PLACE, there, op=MPI.LOR)
    return [" + ".join(regions[b] for b in np.flatnonzero(row)) for row in there]


def _read_whole(comm, path, order, serendipity, surfaces, check):
    """All of a mesh on rank 0: slices, facets between two cells by surface, and a cell in words. *Collective.*"""

    def prepare():
        raw = read_mesh(path)
        check(raw)
        say_lost(raw.path, raw.lost)
        between = {name: facet_multiplicity(raw, *raw.facet_groups[name]) > 1 for name in surfaces}
        curved = any(b.degree == 2 for b in raw.blocks)
        if curved or order == 2:
            raw = complete(raw, 2)
            raw = without_middles(raw) if serendipity else raw
        return raw, curved, components(raw), between

    raw, curved, component, between = on_root(comm, prepare) or (None, False, None, dict.fromkeys(surfaces, []))
    between = {name: np.asarray(inside, dtype=bool) for name, inside in between.items()}
    piece = whole(comm, raw, curved, component)
    return piece, between, lambda cell: cell_name(raw.points, raw.blocks, raw.tags, cell)


def _read_slices(comm, path, order, serendipity, surfaces, check, pairs):
    """The same of a converted mesh, of which every rank has a slice. *Collective.*"""
    stored = ConvertedMesh(comm, path, order, serendipity)
    together(comm, check, stored.summary(pairs))
    say_lost(stored.path, stored.lost)
    return stored.piece, {name: stored.between[name] for name in surfaces}, stored.named


def load_plain(comm, raw):
    """Distribute a mesh that rank 0 has read as one body, without regard to a scene. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    raw : pcontact.mesh.groups.RawMesh or None
        On rank 0.

    Returns
    -------
    Mesh
    """

    def prepare():
        curved = any(block.degree == 2 for block in raw.blocks)
        full = complete(raw, 2) if curved else raw
        return full, curved, components(full)

    return deal(whole(comm, *(on_root(comm, prepare) or (None,) * 3)))


def load_mesh(comm, path, order, regions, pairs, check, dealing=(WEIGHT, "bisection"), serendipity=False):
    """Read, check and distribute a mesh. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    path : str or pathlib.Path
    order : int or None
        Degree of the displacement; None: that of the mesh.
    regions : list of str
        Cell group of each body.
    pairs : list of (str, str or None, float or None)
        Contact pairs: source and target surfaces and search radius, see
        :func:`pcontact.mesh.contact_weights.contact_facets`.
    check : callable
        Called before anything else is done with the mesh; may raise InputError, and cut a mesh that is whole. Its
        argument is a :class:`pcontact.mesh.groups.RawMesh`, on rank 0; or a
        :class:`pcontact.mesh.hdf5_reader.Summary`, on every rank.
    dealing : (float, str)
        Weight and method, see :func:`pcontact.mesh.partition.partition`.
    serendipity : bool
        Quadrilaterals and hexahedra of degree 2 have no nodes in the middles of faces and cells.

    Returns
    -------
    Mesh

    Raises
    ------
    InputError
        On every rank.
    """
    weight, method = dealing
    if not 0.0 <= weight < np.inf:
        raise InputError(f"command line: -partition_weight: found {weight:g}; allowed: a number >= 0")
    surfaces = sorted({name for source, target, _ in pairs for name in (source, target) if name is not None})
    with profile.phase("read"):
        if is_converted(path):
            piece, between, named = _read_slices(comm, path, order, serendipity, surfaces, check, pairs)
        else:
            piece, between, named = _read_whole(comm, path, order, serendipity, surfaces, check)
        _set_bodies(piece, regions, named)
        _check_surfaces(piece, between, named)
        names = _component_names(piece, regions)
        del named
    profile.give_back()
    profile.mark("read")
    with profile.phase("distribute"):
        mesh = deal(piece, pairs, weight, method)
    profile.give_back()
    profile.mark("distribute")
    mesh.component_names = names
    return mesh
