"""From a mesh file to one mesh per rank."""

import numpy as np

from pcontact.mesh.complete import complete
from pcontact.mesh.components import cell_name, components
from pcontact.mesh.distribute import distribute
from pcontact.mesh.groups import facet_multiplicity
from pcontact.mesh.reader import read_mesh
from pcontact.runtime import profile
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root


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


def _weights(raw, surfaces, weight):
    extra = np.zeros(sum(len(b.nodes) for b in raw.blocks))
    for name in surfaces:
        np.add.at(extra, raw.facet_groups[name][0], weight)
    return extra


def _component_names(component, body, regions):
    names = []
    for k in range(int(component.max()) + 1):
        names.append(" + ".join(regions[b] for b in np.unique(body[component == k])))
    return names


def load_mesh(comm, path, order, regions, surfaces, check, weight=0.0):
    """Read, check and distribute a mesh. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    path : str or pathlib.Path
    order : int
        Degree of the displacement.
    regions : list of str
        Cell group of each body.
    surfaces : list of str
        Facet groups that are in contact.
    check : callable
        Called on rank 0 with the raw mesh before anything else is done with it; may raise InputError.
    weight : float
        Work of a contact facet in the partition, in units of the work of a cell; 0: contact does not weigh.

    Returns
    -------
    Mesh

    Raises
    ------
    InputError
        On every rank.
    """
    if not 0.0 <= weight < np.inf:
        raise InputError(f"command line: -partition_weight: found {weight:g}; allowed: a number >= 0")

    def prepare():
        raw = read_mesh(path)
        check(raw)
        body = _bodies(raw, regions)
        _check_contact_facets(raw, surfaces)
        curved = any(b.degree == 2 for b in raw.blocks)
        if curved or order == 2:
            raw = complete(raw, 2)
        component = components(raw)
        extra = _weights(raw, surfaces, weight) if weight > 0.0 else None
        return raw, curved, body, component, extra, _component_names(component, body, regions)

    with profile.phase("read"):
        raw, curved, body, component, extra, names = on_root(comm, prepare) or (None,) * 6
    profile.mark("read")
    with profile.phase("distribute"):
        mesh = distribute(comm, raw, curved, body, component, extra)
    profile.mark("distribute")
    mesh.component_names = comm.bcast(names, root=0)
    return mesh
