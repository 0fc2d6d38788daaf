"""Talking between ranks: agreement on errors, sparse exchange, and the plan that moves nodal values."""

from contextlib import contextmanager

import numpy as np

from pcontact.runtime import profile
from pcontact.runtime.errors import TOLD, InputError
from pcontact.runtime.petsc import MPI, PETSc

CHUNK = 1 << 22  # [bytes] of a chunk of rows at most, which HDF5 compresses as one


def on_root(comm, function, *args):
    """Call a function on rank 0 only; an error there that the user is told of is raised on every rank. *Collective.*

    Returns
    -------
    object
        What the function returned on rank 0, None elsewhere.

    Raises
    ------
    InputError, OutputError
    """
    result, error = None, None
    if comm.rank == 0:
        result, error = _caught(function, args)
    error = comm.bcast(error, root=0)
    if error is not None:
        raise error
    return result


def together(comm, function, *args):
    """Call a function on every rank; an error of any rank that the user is told of is raised on all. *Collective.*

    Returns
    -------
    object
        What the function returned on this rank.

    Raises
    ------
    InputError, OutputError
    """
    result, error = _caught(function, args)
    agree(comm, error)
    return result


def _caught(function, args):
    """Result of a function, or the error that the user, or who calls it with wrong values, is told of."""
    try:
        return function(*args), None
    except (*TOLD, ValueError) as error:
        # what it was raised from stays on this rank
        return None, (type(error) if isinstance(error, TOLD) else ValueError)(str(error))


def agree(comm, error):
    """Raise an error on every rank when any rank has one. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    error : InputError, OutputError, str or None
        A text is the message of an input error. That of the lowest rank wins.

    Raises
    ------
    InputError, OutputError
    """
    rank = comm.allreduce(comm.rank if error is not None else comm.size, op=MPI.MIN)
    if rank < comm.size:
        error = comm.bcast(error, root=rank)
        raise InputError(error) if isinstance(error, str) else error


@contextmanager
def aside_of_root(comm, make):
    """A file that rank 0 writes for all, put in place at the end; what fails there is raised by all. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    make : callable
        Makes the :class:`pcontact.runtime.files.Hdf5Aside`. Whether it can is settled before the others wait for it.

    Yields
    ------
    pcontact.runtime.files.Hdf5Aside or None
        On rank 0; None elsewhere.
    """
    aside = on_root(comm, make)
    try:
        yield aside
        on_root(comm, lambda: aside.place())
    finally:
        if aside is not None:
            aside.discard()


def write_rows(comm, aside, place, array, level=0):
    """Write a dataset of the rows (n, ...) of all ranks; they hand them to rank 0 in turn, so that memory for those of
    one more rank is enough. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    aside : pcontact.runtime.files.Hdf5Aside
        Of rank 0; None elsewhere.
    place : str
        Path of the dataset in the file.
    array : ndarray (n, ...)
    level : int
        Of deflate, 0 none.
    """
    array, first = np.ascontiguousarray(array), 0
    counts = comm.allgather(len(array))
    if comm.rank != 0:
        comm.recv(source=0)
        comm.Send(array, dest=0)
        return
    chunk = max(CHUNK // max(array.itemsize * int(np.prod(array.shape[1:])), 1), 1)
    how = {"chunks": (min(sum(counts), chunk), *array.shape[1:]), "compression": level} if level and any(counts) else {}
    dataset = aside.file.create_dataset(place, (sum(counts), *array.shape[1:]), array.dtype, **how)
    for rank, rows in enumerate(counts):
        if rank > 0:
            array = np.empty((rows, *array.shape[1:]), array.dtype)
            comm.send(None, dest=rank)
            comm.Recv(array, source=rank)
        # what fails is told when the file is put in place; until then the other ranks have to be heard
        if not aside.failed:
            dataset[first : first + rows] = array
        first += rows


class Exchanger:
    """Sparse exchange of arrays on a private communicator, with counts of what was sent.

    Parameters
    ----------
    comm : MPI.Comm
        Duplicated. *Collective.*

    Attributes
    ----------
    messages, bytes : int
        Sent by this rank to others since the start.
    """

    def __init__(self, comm):
        self.comm = comm.Dup()
        self.messages = 0
        self.bytes = 0
        self._tag = 0

    def free(self):
        """Give the communicator back; a second call does nothing. *Collective.*"""
        if self.comm != MPI.COMM_NULL:
            self.comm.Free()

    def __call__(self, sends, dtype, columns):
        """Send a two-dimensional array to each of a few ranks and receive what others send here. *Collective.*

        Nobody knows how many messages to expect: synchronous sends and a non-blocking barrier end the exchange
        (Hoefler, Siebert, Lumsdaine 2010), so the cost follows the number of partners, not of ranks.

        Parameters
        ----------
        sends : dict of int to ndarray (n, columns)
        dtype : numpy dtype
        columns : int

        Returns
        -------
        dict of int to ndarray (n, columns)
            By source rank, in ascending order of the source.
        """
        with profile.phase("exchange"):
            messages, size = self.messages, self.bytes
            received = self._exchange(sends, np.dtype(dtype), columns)
            profile.sent(self.messages - messages, self.bytes - size)
        return received

    def deliver(self, homes, rows):
        """Rows (m, k) that all ranks have for this one, of rows (n, k) for the ranks `homes` (n,). *Collective.*"""
        heard = self(split_by_rank(homes, rows)[0], rows.dtype, rows.shape[1])
        return np.concatenate([rows[:0], *heard.values()])

    def ask(self, homes, rows, answer):
        """Return what other ranks say of rows, in the order of these. *Collective.*

        Parameters
        ----------
        homes : ndarray (n,) of int
            The ranks that are asked.
        rows : ndarray (n, k)
        answer : callable
            Makes of all rows (m, k) that came to this rank what is said of them, (m, w).

        Returns
        -------
        ndarray (n, w)
        """
        asked = Asked(self, homes, rows)
        return asked.reply(answer(asked.rows))

    def sharers(self, homes, numbers):
        """Other ranks that have the same numbers: rows (m, 2) of number and rank, one for each rank. *Collective.*

        Parameters
        ----------
        homes : ndarray (n,) of int
            The ranks that hear of all that have a number.
        numbers : ndarray (n,) int64
            Of this rank, each once.
        """
        heard = self(split_by_rank(homes, numbers)[0], np.int64, 1)
        number = np.concatenate([np.zeros(0, np.int64), *(part.ravel() for part in heard.values())])
        rank = np.repeat(np.array([*heard], dtype=np.int64), [len(part) for part in heard.values()])
        order = np.lexsort((rank, number))
        number, rank = number[order], rank[order]
        _, first, place, count = np.unique(number, return_index=True, return_inverse=True, return_counts=True)
        # every rank of a number with every other
        one = np.repeat(np.arange(len(number)), count[place])
        other = first[place[one]] + np.arange(len(one)) - (np.cumsum(count[place]) - count[place])[one]
        away = rank[one] != rank[other]
        return self.deliver(rank[one][away], np.column_stack([number[one], rank[other]])[away])

    def look_up(self, known, values, wanted):
        """Values that any rank knows by keys. *Collective.*

        Parameters
        ----------
        known, wanted : (ndarray (n,), ndarray (n,) int64), (ndarray (m,), ndarray (m,) int64)
            The ranks that are the homes of keys, and the keys.
        values : ndarray (n, k) int64
            At the known keys.

        Returns
        -------
        ndarray (m,) of bool, ndarray (m, k) int64
            Whether a key is known, and its values.
        """
        table = self.deliver(known[0], np.column_stack([known[1], values]))
        table = table[np.argsort(table[:, 0], kind="stable")]

        def answer(rows):
            at = np.minimum(np.searchsorted(table[:, 0], rows[:, 0]), max(len(table) - 1, 0))
            found = np.zeros((len(rows), table.shape[1]), dtype=np.int64)
            if len(table):
                found[:] = table[at]
                found[:, 0] = table[at, 0] == rows[:, 0]
            return found

        found = self.ask(wanted[0], wanted[1][:, None], answer)
        return found[:, 0] > 0, found[:, 1:]

    def _exchange(self, sends, dtype, columns):
        comm = self.comm
        received = {}
        self._tag = (self._tag + 1) % 16384
        pending, kept = [], []
        for rank, array in sends.items():
            array = np.ascontiguousarray(array, dtype=dtype).reshape(-1, columns)
            if rank == comm.rank:
                received[rank] = array
                continue
            kept.append(array)
            pending.append(comm.Issend([array, MPI.BYTE], dest=rank, tag=self._tag))
            self.messages += 1
            self.bytes += array.nbytes
        if comm.size > 1:
            self._collect(received, pending, dtype, columns)
        return dict(sorted(received.items()))

    def _collect(self, received, pending, dtype, columns):
        comm, status, barrier, done = self.comm, MPI.Status(), None, False
        while not done:
            message = comm.Improbe(source=MPI.ANY_SOURCE, tag=self._tag, status=status)
            if message is not None:
                buffer = np.empty(status.Get_count(MPI.BYTE), dtype=np.uint8)
                source = status.Get_source()
                message.Recv([buffer, MPI.BYTE])
                received[source] = buffer.view(dtype).reshape(-1, columns)
            if barrier is None:
                if MPI.Request.Testall(pending):
                    barrier = comm.Ibarrier()
            else:
                done = barrier.Test()


def split_by_rank(ranks, array):
    """Rows of an array grouped by destination, keeping their order.

    Parameters
    ----------
    ranks : ndarray (n,)
    array : ndarray (n, ...)

    Returns
    -------
    dict of int to ndarray, ndarray (n,)
        The groups, and the permutation that sorts by rank (stable).
    """
    order = np.argsort(ranks, kind="stable")
    values, starts = np.unique(ranks[order], return_index=True)
    pieces = np.split(array[order], starts[1:]) if len(values) else []
    return {int(r): p for r, p in zip(values, pieces, strict=True)}, order


class Asked:
    """Rows that all ranks ask others about; each rank answers those that came to it. *Collective.*

    Parameters
    ----------
    exchanger : Exchanger
    homes : ndarray (n,) of int
        The ranks that are asked.
    rows : ndarray (n, k)

    Attributes
    ----------
    rows : ndarray (m, k)
        Rows that came here.
    """

    def __init__(self, exchanger, homes, rows):
        self._exchanger = exchanger
        sends, self._order = split_by_rank(homes, rows)
        heard = exchanger(sends, rows.dtype, rows.shape[1])
        self.rows = np.concatenate([rows[:0], *heard.values()])
        self._ends = np.cumsum([0, *(len(part) for part in heard.values())])
        self._from, self._of = list(heard), sorted(sends)
        self._firsts = np.cumsum([0, *(len(sends[rank]) for rank in self._of)])

    def reply(self, said):
        """Return what ranks say (n, w) of the rows, in their order, from what this one says (m, w). *Collective.*"""
        told = self._back(np.split(said, self._ends[1:-1]), said)
        result = np.empty((len(self._order), said.shape[1]), said.dtype)
        result[self._order] = np.concatenate([said[:0], *told])
        return result

    def reply_some(self, which, said):
        """The same where a row may have any number of answers: this one's are those of rows `which` (l,), ascending.
        *Collective.*

        Returns
        -------
        rows : ndarray (j,)
        answers : ndarray (j, w) of float
        """
        table = np.column_stack([which, said]).astype(float, copy=False)
        parts = np.split(table, np.searchsorted(which, self._ends[1:-1]))
        for first, part in zip(self._ends, parts, strict=False):
            part[:, 0] -= first
        told = self._back(parts, table)
        for start, part in zip(self._firsts, told, strict=False):
            part[:, 0] += start
        table = np.concatenate([table[:0], *told])
        return self._order[table[:, 0].astype(np.int64)], table[:, 1:]

    def _back(self, parts, table):
        told = self._exchanger(dict(zip(self._from, parts, strict=False)), table.dtype, table.shape[1])
        return [told[rank] for rank in self._of]


class NodeExchange:
    """Plan that brings the values of some nodes here from a distributed vector, and adds values back.

    Parameters
    ----------
    vector : PETSc.Vec
        Distributed vector of block size ``dim``, as a template.
    nodes : ndarray (n,)
        Global node numbers wanted on this rank, owned or not.
    dim : int
        Values per node.

    Attributes
    ----------
    messages, bytes : int
        What one call moves between this rank and the owners of its nodes, itself left out.

    Notes
    -----
    The constructor is *Collective*, and so are the calls.
    """

    def __init__(self, vector, nodes, dim):
        self.nodes = np.ascontiguousarray(nodes, dtype=np.int64)
        self.dim = dim
        # on one rank that wants all nodes in their order, the vector is the answer
        count = vector.getSize() // dim
        self._whole = vector.comm.size == 1 and np.array_equal(self.nodes, np.arange(count))
        self._local = PETSc.Vec().createSeq(len(self.nodes) * dim, bsize=dim)
        index = PETSc.IS().createBlock(dim, self.nodes.astype(PETSc.IntType), comm=vector.comm)
        self._scatter = PETSc.Scatter().create(vector, index, self._local, None)
        owners = np.searchsorted(vector.getOwnershipRanges(), self.nodes * dim, side="right") - 1
        others = owners[owners != vector.comm.rank]
        self.messages, self.bytes = len(np.unique(others)), 8 * dim * len(others)

    def gather(self, vector):
        """Values of the nodes, as a fresh array (n, dim). *Collective.*"""
        if self._whole:
            return vector.getArray(readonly=True).reshape(-1, self.dim).copy()
        with profile.phase("exchange"):
            self._scatter.scatter(vector, self._local, addv=PETSc.InsertMode.INSERT_VALUES)
        profile.sent(self.messages, self.bytes)
        return self._local.getArray(readonly=True).reshape(-1, self.dim).copy()

    def add(self, values, vector):
        """Add values (n, dim) of the nodes to the distributed vector. *Collective.*"""
        if self._whole:
            vector.setArray(vector.getArray(readonly=True) + np.asarray(values).ravel())
            return
        self._local.setArray(np.asarray(values).ravel())
        with profile.phase("exchange"):
            self._scatter.scatter(
                self._local, vector, addv=PETSc.InsertMode.ADD_VALUES, mode=PETSc.ScatterMode.REVERSE
            )
        profile.sent(self.messages, self.bytes)


def matching(keys, chunks):
    """Rows of other ranks' tables that belong here.

    Parameters
    ----------
    keys : ndarray (n,)
        Of the rows of this rank, each once.
    chunks : iterable of (ndarray (m,), ndarray (m, k))
        Keys and values, a part of the table at a time.

    Yields
    ------
    rows : ndarray
        Of this rank.
    values : ndarray (len(rows), k)
    """
    order = np.argsort(keys)
    ordered = keys[order]
    for found, values in chunks:
        place = np.searchsorted(ordered, found)
        here = place < len(ordered)
        here[here] = ordered[place[here]] == found[here]
        yield order[place[here]], values[here]


def rows_of(keys, wanted):
    """Rows (...) of the keys (n,), each once, that have the wanted values (...); -1 where none has."""
    if not len(keys):
        return np.full(np.shape(wanted), -1)
    order = np.argsort(keys)
    rows = order[np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)]
    return np.where(keys[rows] == wanted, rows, -1)


def kept_rows(keys, table):
    """Keys and rows of a table (n, m) that are not zero, from which :func:`take_rows` makes it again."""
    rows = np.flatnonzero(table.any(axis=1))
    return keys[rows], table[rows]


def take_rows(keys, chunks, out):
    """Fill a table with the rows of other ranks' tables that belong here; those that nobody has become zero.

    Parameters
    ----------
    keys, chunks
        As for :func:`matching`.
    out : ndarray (n, k)
        Overwritten.

    Returns
    -------
    int
        Rows that were found, each counted once; of a table with another number of columns none.
    """
    out[:] = 0.0
    there = np.zeros(len(keys), dtype=bool)
    for rows, values in matching(keys, chunks):
        if values.shape[1:] != out.shape[1:]:
            return 0
        out[rows], there[rows] = values, True
    return int(np.sum(there))
