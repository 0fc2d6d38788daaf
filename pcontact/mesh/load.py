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
from pcontact.runtime.parallel import on_root, together


def _named(raw, cell):
    return cell_name(raw.points, raw.blocks, raw.tags, int(cell))


def _bodies(raw, regions):
    """Body number of every cell; a cell in no body or in two is an error."""
    n_cells = sum(len(b.nodes) for b in raw.blocks)
    body = np.full(n_cells, -1, dtype=np.int64)
    for number, region in enumerate(regions):
        cells = raw.cell_groups[region]
        taken = cells[body[cells] >= 0]
        if len(taken):
            raise InputError(
                f"{raw.path}: {_named(raw, taken[0])} of body {region!r} is also in body "
                f"{regions[body[taken[0]]]!r} ({len(taken)} in all); allowed: every cell in one body"
            )
        body[cells] = number
    homeless = np.flatnonzero(body < 0)
    if len(homeless):
        names = [name for name, cells in raw.cell_groups.items() if np.isin(homeless[0], cells)]
        where = f"of group {names[0]!r}" if names else "of no group"
        raise InputError(
            f"{raw.path}: {_named(raw, homeless[0])} {where} is in no body ({len(homeless)} in all); "
            "allowed: every cell in the region of one of the [[bodies]]"
        )
    return body


def _check_contact_facets(raw, surfaces):
    for name in surfaces:
        cells, local = raw.facet_groups[name]
        inside = np.flatnonzero(facet_multiplicity(raw, cells, local) > 1)
        if len(inside):
            raise InputError(
                f"{raw.path}: contact surface {name!r} has {len(inside)} facets between two cells, the first one at "
                f"{_named(raw, cells[inside[0]])}; allowed: facets on the boundary of a body (bodies in contact must "
                "not share nodes)"
            )


def _component_names(component, body, regions):
    pairs = np.unique(component * len(regions) + body)
    names = [[] for _ in range(int(component.max()) + 1)]
    for k, b in zip(*np.divmod(pairs, len(regions)), strict=True):
        names[k].append(regions[b])
    return [" + ".join(name) for name in names]


def _read_whole(comm, path, order, serendipity, regions, surfaces, check):
    """All of a mesh on rank 0. *Collective.*"""

    def prepare():
        raw = read_mesh(path)
        check(raw)
        say_lost(raw.path, raw.lost)
        body = _bodies(raw, regions)
        _check_contact_facets(raw, surfaces)
        curved = any(b.degree == 2 for b in raw.blocks)
        if curved or order == 2:
            raw = complete(raw, 2)
            raw = without_middles(raw) if serendipity else raw
        component = components(raw)
        return (raw, curved, body, component), _component_names(component, body, regions)

    arguments, names = on_root(comm, prepare) or ((None,) * 4, None)
    return whole(comm, *arguments), comm.bcast(names, root=0)


def _read_slices(comm, path, order, serendipity, regions, surfaces, check, pairs):
    """A slice of a converted mesh on every rank. *Collective.*"""
    stored = ConvertedMesh(comm, path, order, serendipity)
    together(comm, check, stored.summary(pairs))
    say_lost(stored.path, stored.lost)
    stored.set_bodies(regions)
    stored.check_surfaces(surfaces)
    return stored.piece, stored.component_names(regions)


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
        return full, curved, np.zeros(full.offsets[-1], dtype=np.int64), components(full)

    return deal(whole(comm, *(on_root(comm, prepare) or (None,) * 4)))


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
            piece, names = _read_slices(comm, path, order, serendipity, regions, surfaces, check, pairs)
        else:
            piece, names = _read_whole(comm, path, order, serendipity, regions, surfaces, check)
    profile.give_back()
    profile.mark("read")
    with profile.phase("distribute"):
        mesh = deal(piece, pairs, weight, method)
    profile.give_back()
    profile.mark("distribute")
    mesh.component_names = names
    return mesh
