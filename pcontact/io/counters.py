"""What a run holds and does, counted: bytes of arrays by item, calls of kernels.

Physics that a scene does not use must not show here: the counters of a scene without it are those of a program that
does not have it.
"""

import numpy as np

from pcontact.runtime.jit import CALLS


def held(thing, shared=()):
    """Bytes of all arrays that an object reaches, by the attribute through which it reaches them.

    Parameters
    ----------
    thing : object
    shared : sequence
        Objects that are not its own: neither they nor what they hold directly counts.

    Returns
    -------
    dict of str to int
        Paths such as ``source.jxw``; arrays that overlap count once. Those of a list or dict count together.
    """
    result = {}
    seen = {id(one) for one in shared}
    for one in shared:
        seen.update(id(_whole(part)) for part in vars(one).values())
    _walk(thing, "", seen, result)
    return result


def _whole(thing):
    """The array of which another one is a view."""
    while isinstance(thing, np.ndarray) and isinstance(thing.base, np.ndarray):
        thing = thing.base
    return thing


def _walk(thing, path, seen, result):
    thing = _whole(thing)
    if id(thing) in seen or isinstance(thing, type) or callable(thing):
        return
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        if thing.nbytes:
            result[path] = result.get(path, 0) + thing.nbytes
    elif isinstance(thing, dict):
        for part in thing.values():
            _walk(part, path, seen, result)
    elif hasattr(thing, "_asdict") or hasattr(thing, "__dict__"):
        # attributes that a name hides are the same thing to a reader of the report
        parts = thing._asdict() if hasattr(thing, "_asdict") else vars(thing)
        for name, part in parts.items():
            _walk(part, f"{path}.{name.lstrip('_')}" if path else name.lstrip("_"), seen, result)
    elif isinstance(thing, (list, tuple)):
        for part in thing:
            _walk(part, path, seen, result)


class Counters:
    """Of a run, from its beginning on.

    Parameters
    ----------
    space : pcontact.space.space.Space
    parts : sequence of pcontact.assembly.item.Item
    before : collections.Counter
        Calls of kernels before the run.
    """

    def __init__(self, space, parts, before):
        self._space, self._before = space, before
        self._parts = {part.name: part for part in parts}

    def __call__(self):
        """Counts of all ranks. *Collective.*

        Returns
        -------
        dict
            ``kernels``: calls by kernel; ``bytes``: by item and attribute (`held`); ``points``: quadrature points by
            item, where it keeps something at them; ``bytes_per_unknown``: of all items; ``bytes_per_point``: by item.
        """
        space, parts = self._space, self._parts
        shared = (space, space.mesh)
        own = {
            "kernels": dict(CALLS - self._before),
            "bytes": {name: held(part, shared) for name, part in parts.items()},
            "points": {name: part.counters()["points"] for name, part in parts.items()},
        }
        total = space.comm.allreduce(own, op=_sum)
        sizes = {name: sum(table.values()) for name, table in total["bytes"].items()}
        total["points"] = {name: count for name, count in total["points"].items() if count}
        total["bytes_per_unknown"] = sum(sizes.values()) / space.n_dofs
        total["bytes_per_point"] = {name: sizes[name] / count for name, count in total["points"].items()}
        return total


def _sum(a, b):
    """Sum of nested dicts of numbers."""
    names = sorted(a.keys() | b.keys())
    nested = {name for name in names if isinstance(a.get(name, b.get(name)), dict)}
    return {
        name: _sum(a.get(name, {}), b.get(name, {})) if name in nested else a.get(name, 0) + b.get(name, 0)
        for name in names
    }
