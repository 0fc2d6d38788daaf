"""Writing of all files: aside and put in place at once. What cannot be written is an output error.

Whatever happens, a reader finds the file of before or the new one, whole. Nothing here is collective: what one rank
writes for all goes through :func:`pcontact.runtime.parallel.on_root` or ``together``, so that all ranks learn of it.

Checksums at the end of a file, by which every rank verifies a part of it before anything is read.

    content | CRC-32 of every block of the content | MARK, size of a block and of the content | CRC-32 of the last two

They cover every byte, those in which HDF5 keeps its own tables, too; HDF5 takes no notice of what follows its content.
"""

import errno
import io
import os
import struct
import zlib
from contextlib import contextmanager, suppress
from pathlib import Path

import h5py
import numpy as np

from pcontact.runtime.errors import InputError, OutputError

MARK = b"pcontact CRC-32\n"
BLOCK = 1 << 20  # bytes: as much is in memory at a time
HEAD, SUM = struct.Struct("<16sQQ"), struct.Struct("<I")
TAIL = HEAD.size + SUM.size
# reasons that speak of a wrong name, which is wrong input where the user has just given the name
NAMES = (errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ENAMETOOLONG, errno.ELOOP, errno.EINVAL)
# names of files of geometries end so; those of them that are scripts, which gmsh runs
SCRIPTS = (".geo", ".geo_unrolled")
GEOMETRIES = (*SCRIPTS, ".brep", ".step", ".stp")
PROBE = 1 << 20  # bytes: more than a full disk or a used up quota takes

# what is being written, to be taken away if a signal ends the process
_aside = set()


class Damaged(Exception):
    """A file is not as it was written; the message says where."""


def append_checksums(path):
    """Write the checksums of a file to its end.

    Parameters
    ----------
    path : str or pathlib.Path

    Raises
    ------
    OSError
    """
    size = os.path.getsize(path)
    with open(path, "r+b") as stream:
        sums = [zlib.crc32(stream.read(BLOCK)) for _ in range(_count(size, BLOCK))]
        table = np.array(sums, "<u4").tobytes() + HEAD.pack(MARK, BLOCK, size)
        stream.seek(size)
        stream.write(table + SUM.pack(zlib.crc32(table)))


def verify(path, rank=0, ranks=1):
    """Compare a part of a file with its checksums.

    Parameters
    ----------
    path : str or pathlib.Path
    rank, ranks : int
        Each of so many ranks reads an even share of the blocks.

    Returns
    -------
    bool
        Whether the file has checksums; if not, nothing is known of it.

    Raises
    ------
    Damaged
    OSError
    """
    with open(path, "rb") as stream:
        end = stream.seek(0, os.SEEK_END)
        if end < TAIL:
            return False
        stream.seek(end - TAIL)
        mark, block, size = HEAD.unpack(stream.read(HEAD.size))
        if mark != MARK:
            return False
        count = _count(size, block)
        if block != BLOCK or size + 4 * count + TAIL != end:
            raise Damaged(f"{end} bytes, which its checksums do not fit")
        stream.seek(size)
        table = stream.read(end - size - SUM.size)
        if SUM.unpack(stream.read(SUM.size))[0] != zlib.crc32(table):
            raise Damaged("checksums that are not as they were written")
        first, last = (k * count // ranks for k in (rank, rank + 1))
        stream.seek(first * block)
        for k, wanted in enumerate(np.frombuffer(table, "<u4", last - first, 4 * first).tolist(), first):
            if zlib.crc32(stream.read(min(block, size - k * block))) != wanted:
                raise Damaged(f"bytes from {k * block} on that are not as they were written")
    return True


def _count(size, block):
    return -(-size // max(block, 1))


def reason(error):
    """Return what the system says of a failure, in lower case."""
    return (error.strerror or str(error)).lower()


@contextmanager
def telling(path, option=None):
    """Turn what the system says of a file into an error that the user is told of.

    Parameters
    ----------
    path : str or pathlib.Path
        The file, for the message.
    option : str, optional
        The user has just named the file with it: a wrong name is wrong input.

    Raises
    ------
    OutputError
        The file cannot be written.
    InputError
        The option names a file that cannot be.
    """
    try:
        yield
    except OSError as error:
        if option is not None and error.errno in NAMES:
            raise InputError(
                f"command line: {option} {path}: found {reason(error)}; allowed: a file that can be made and written to"
            ) from error
        raise OutputError(f"{path}: cannot be written ({reason(error)}); what was written before is whole") from error


@contextmanager
def going_on(path):
    """Turn what is wrong with a file of the results that a run goes on with into an error that the user is told of.

    Parameters
    ----------
    path : str or pathlib.Path
        Made by the program, and read inside.

    Raises
    ------
    InputError
    """
    try:
        yield
    except (OSError, ValueError, LookupError, TypeError, AttributeError, SyntaxError) as error:
        why = " ".join((reason(error) if isinstance(error, OSError) else str(error)).split())
        raise InputError(
            f"{path}: found what cannot be read ({why}); allowed: results as they were written, or another -o"
        ) from error


@contextmanager
def reading(path, words):
    """Turn what goes wrong in a reader, which may be anything, into an input error.

    Parameters
    ----------
    path : str or pathlib.Path
    words : str
        Of the message, in which ``{reason}`` is what goes wrong, and ``{kind}`` its class.

    Raises
    ------
    InputError
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        said = {"kind": type(error).__name__, "reason": " ".join(str(error).split())}
        raise InputError(f"{path}: {words.format(**said)}") from None


@contextmanager
def written_aside(path, option=None):
    """A place beside a file to write to; at the end it becomes the file. After a failure nothing is left of it.

    Parameters
    ----------
    path : str or pathlib.Path
    option : str, optional
        See :func:`telling`.

    Yields
    ------
    pathlib.Path
        ``NAME.part``, with the suffix of the file where an option names it: others tell its kind by that.

    Raises
    ------
    InputError, OutputError
        See :func:`telling`.
    """
    path = Path(path)
    part = path.with_name(f"{path.name}.part{path.suffix if option else ''}")
    _aside.add(part)
    try:
        with telling(path, option):
            yield part
            os.replace(part, path)
    finally:
        discard(part)


def forget_at_the_end(path):
    """Have a file taken away if a signal ends the process."""
    _aside.add(path)


def discard(part):
    """Take a file away, if it is there."""
    with suppress(OSError):
        part.unlink(missing_ok=True)
    _aside.discard(part)


def discard_all():
    """Take away all that is being written: the process ends."""
    for part in tuple(_aside):
        discard(part)


def make_directory(path):
    """Make a directory and those above it, if they are not there.

    Raises
    ------
    OutputError
    """
    with telling(path):
        Path(path).mkdir(parents=True, exist_ok=True)


def _utf8(text):
    """Text for a file; names of files keep the bytes that they have on disk, unless these are no UTF-8."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace").encode("utf-8")


def replace_file(path, content):
    """Write a file aside and put it in place at once, so that it is never seen half written.

    Parameters
    ----------
    path : str or pathlib.Path
    content : str, bytes or iterable of these
        What it holds afterwards.

    Raises
    ------
    OutputError
    """
    content = [content] if isinstance(content, (str, bytes)) else content
    with written_aside(path) as part, open(part, "wb") as stream:
        stream.writelines(_utf8(piece) if isinstance(piece, str) else piece for piece in content)


def append_text(path, text, tail=""):
    """Add to a file that is there, all or nothing.

    Parameters
    ----------
    path : str or pathlib.Path
    text : str
    tail : str
        Which ends the file before and afterwards.

    Raises
    ------
    OutputError
        The file is as it was.
    """
    rest, tail = _utf8(text + tail), _utf8(tail)
    with telling(path), open(path, "r+b", buffering=0) as stream:
        size = stream.seek(-len(tail), os.SEEK_END)
        try:
            while rest:
                rest = rest[stream.write(rest) :]
        except OSError:
            stream.truncate(size)
            stream.seek(size)
            stream.write(tail)
            raise


def whole_lines(path):
    """Lines of a file that grows by :func:`append_text`, but one that a process which was killed has left unfinished.

    Yields
    ------
    str
        With its line feed.
    """
    with open(path, "rb") as stream:
        for line in stream:
            if line.endswith(b"\n"):
                yield line.decode("utf-8")


def require_end(part, ends):
    """Find out whether another program has written a file to its end: some do not notice that a disk is full.

    Parameters
    ----------
    part : pathlib.Path
    ends : bytes
        In the last line of a whole file.

    Raises
    ------
    OSError
        With the reason of the system, where it has one.
    """
    with open(part, "r+b", buffering=0) as stream:
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(size - 80, 0))
        if ends in stream.read().rstrip(b"\n").rpartition(b"\n")[2]:
            return
        stream.seek(0, os.SEEK_END)
        rest = PROBE
        while rest:
            rest -= stream.write(bytes(rest))
    raise OSError(errno.EIO, "not written to its end")


class Hdf5Aside:
    """An HDF5 file that is written aside, with checksums at its end (`pcontact.runtime.files`).

    HDF5 never learns that the disk is full, or anything else that is wrong with it: a file that it cannot close stays
    half open, and the end of the process crashes in it. It writes to an object that notes the failure and lets HDF5
    go on; `place` tells of it.

    Parameters
    ----------
    path : str or pathlib.Path
        The file.
    option : str, optional
        See :func:`telling`.
    summed : bool
        Whether it has checksums.

    Attributes
    ----------
    file : h5py.File

    Raises
    ------
    InputError, OutputError
        It cannot be made.
    """

    def __init__(self, path, option=None, summed=True):
        self.path, self._option, self._summed = Path(path), option, summed
        self._part = self.path.with_name(self.path.name + ".part")
        with telling(path, option):
            self._disk = _Disk(open(self._part, "w+b", buffering=0))
        _aside.add(self._part)
        try:
            self.file = h5py.File(self._disk, "w")
        except BaseException:
            self._disk.close()
            raise

    @property
    def failed(self):
        """Return whether something could not be written."""
        return self._disk.failure is not None

    def place(self):
        """Put the file in place once the disk has it.

        Raises
        ------
        InputError, OutputError
            See :func:`telling`; the file of before is still there.
        """
        try:
            with telling(self.path, self._option):
                self.file.close()
                self._disk.finish()
                if self._summed:
                    append_checksums(self._part)
                self._disk.sync()
                os.replace(self._part, self.path)
        finally:
            self.discard()

    def discard(self):
        """Close the file and leave nothing of what was written, unless it is in place. May be called again."""
        self.file.close()
        self._disk.close()
        discard(self._part)


class _Disk(io.RawIOBase):
    """A file that notes the first failure, and from then on only seems to write."""

    def __init__(self, stream):
        self._stream, self._size, self.failure = stream, 0, None

    def write(self, data):
        view, start = memoryview(data).cast("B"), self._stream.tell()
        try:
            rest = view
            while rest and self.failure is None:
                rest = rest[self._stream.write(rest) :]
        except OSError as error:
            self.failure = error
        end = start + len(view)
        self._size = max(self._size, end)
        self._stream.seek(end)
        return len(view)

    def readinto(self, buffer):
        """Read; what is not there reads as zeros, as far as HDF5 has written."""
        view, start = memoryview(buffer).cast("B"), self._stream.tell()
        count = self._stream.readinto(view) or 0
        more = max(min(len(view), self._size - start) - count, 0)
        view[count : count + more] = bytes(more)
        self._stream.seek(start + count + more)
        return count + more

    def seek(self, offset, whence=os.SEEK_SET):
        return self._stream.seek(self._size + offset if whence == os.SEEK_END else offset,
                                 os.SEEK_SET if whence == os.SEEK_END else whence)  # fmt: skip

    def tell(self):
        return self._stream.tell()

    def truncate(self, size=None):
        self._size = self.tell() if size is None else size
        try:
            self._stream.truncate(self._size)
        except OSError as error:
            self.failure = self.failure or error
        return self._size

    def flush(self):
        """Nothing is kept here."""

    def finish(self):
        """Raise what was noted."""
        if self.failure is not None:
            raise self.failure

    def sync(self):
        """Wait until the disk has the file."""
        os.fsync(self._stream.fileno())

    def close(self):
        self._stream.close()
        super().close()
