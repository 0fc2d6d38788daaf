"""A mesh that rank 0 has, with the bodies of its cells, on all ranks."""

from pcontact.mesh.distribute import deal
from pcontact.mesh.slices import whole


def distribute(comm, raw, curved, body_of_cell, component, pairs=()):
    """Deal a mesh that rank 0 has read, other ranks give None. *Collective.*

    body_of_cell, component (n_cells,): body number, and connected component.
    """
    piece = whole(comm, raw, curved, component)
    if body_of_cell is not None:
        piece.body = body_of_cell
    return deal(piece, pairs)
