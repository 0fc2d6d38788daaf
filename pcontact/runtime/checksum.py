"""Checksums at the end of a file, by which every rank verifies a part of it before anything is read.

    content | CRC-32 of every block of the content | MARK, size of a block and of the content | CRC-32 of the last two

They cover every byte, those in which HDF5 keeps its own tables, too; HDF5 takes no notice of what follows its content.
"""

import os
import struct
import zlib

import numpy as np

MARK = b"pcontact CRC-32\n"
BLOCK = 1 << 20  # bytes: as much is in memory at a time
HEAD, SUM = struct.Struct("<16sQQ"), struct.Struct("<I")
TAIL = HEAD.size + SUM.size


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
