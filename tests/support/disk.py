"""A disk that is full."""

import resource
from contextlib import contextmanager


@contextmanager
def full(size):
    """No file of this process grows beyond some bytes, which files notice as they do a full disk."""
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, old[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
