"""One run writes to a directory at a time: a lock that dies with its process, wherever the process dies."""

import errno
import fcntl
import os
import socket
from contextlib import contextmanager, suppress
from pathlib import Path

from pcontact.runtime import files, log
from pcontact.runtime.errors import InputError, OutputError
from pcontact.runtime.parallel import on_root

NAME = "pcontact.lock"
# what a file system without locks says
WITHOUT = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP)


@contextmanager
def reserved(directory, comm, said="command line: -o"):
    """Make an output directory and keep others from writing to it. *Collective.*

    A directory that was made for nothing is taken away again.

    Parameters
    ----------
    directory : str, pathlib.Path or None
        None: nothing is written.
    comm : MPI.Comm
    said : str
        Where the user names the directory, for messages.

    Raises
    ------
    InputError
        On every rank: it cannot be a directory.
    OutputError
        On every rank: another run writes there, or nobody can.
    """
    lock = None if directory is None else on_root(comm, _Lock, directory, said)
    try:
        yield
    finally:
        if lock is not None:
            lock.release()


class _Lock:
    """A locked file in a directory.

    ``flock`` works between the machines of a network file system, too: Linux has the server keep the lock.
    """

    def __init__(self, directory, said):
        folder = Path(directory).absolute()
        above = [path for path in (folder, *folder.parents) if not os.path.exists(path)]
        existing = above[-1].parent if above else folder
        if not existing.is_dir():
            raise _refused(said, directory, existing, "not a directory")
        self._made, self._path = above, folder / NAME
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = self._locked(directory)
            self._sign()
        except OSError as error:
            self._remove()
            if error.errno in files.NAMES:
                raise _refused(said, directory, existing, files.reason(error)) from None
            raise OutputError(f"{directory}: cannot be written to ({files.reason(error)})") from None
        files.forget_at_the_end(self._path)

    def _locked(self, directory):
        while True:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                if error.errno in WITHOUT:
                    log.warning("%s: its file system has no locks: a second run that writes there is not noticed",
                                directory)  # fmt: skip
                    return file
                holder = os.read(file, 200).decode(errors="replace").split()
                os.close(file)
                if error.errno not in (errno.EAGAIN, errno.EACCES):
                    raise
                who = f" (process {holder[0]} on {holder[1]})" if len(holder) == 2 else ""
                raise OutputError(f"{directory}: another run writes there{who}; allowed: another directory") from None
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file), os.stat(self._path)):
                    return file
            # the other run has just ended and taken the file away
            os.close(file)

    def _sign(self):
        """Say whose the lock is: a trial, too, which tells more than permissions do."""
        try:
            os.ftruncate(self._file, 0)
            os.write(self._file, f"{os.getpid()} {socket.gethostname()}\n".encode())
        except OSError:
            files.discard(self._path)
            os.close(self._file)
            raise

    def release(self):
        """Let others write there."""
        files.discard(self._path)
        os.close(self._file)
        self._remove()

    def _remove(self):
        """Take away the directories that were made, if nothing is in them."""
        with suppress(OSError):
            for path in self._made:
                path.rmdir()


def _refused(said, directory, existing, reason):
    found = f"{said} {directory}: found {existing}: {reason}"
    return InputError(f"{found}; allowed: a directory that can be made and written to")
