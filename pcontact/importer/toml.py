"""The text of a scene file."""

import math


def value(one):
    """A value as TOML has it."""
    if isinstance(one, bool):
        return "true" if one else "false"
    if isinstance(one, str):
        escaped = one.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c.isprintable() else " " for c in escaped) + '"'
    if isinstance(one, dict):
        return "{ " + ", ".join(f"{key(name)} = {value(part)}" for name, part in one.items()) + " }"
    if isinstance(one, (list, tuple)):
        return f"[{', '.join(map(value, one))}]"
    if isinstance(one, float):
        return repr(one) if math.isfinite(one) else "inf"
    return str(one)


def key(name):
    """A key, in quotes where it needs them."""
    return name if name and all(c.isascii() and (c.isalnum() or c in "_-") for c in name) else value(name)


def text(tables, head=()):
    """A file from its tables.

    Parameters
    ----------
    tables : list of (str, dict, str)
        Header such as "[mesh]", or "" for the keys before any; keys and values; a comment or "".
    head : sequence of str
        Lines of the comment at the beginning.

    Returns
    -------
    str
    """
    lines = [f"# {line}".rstrip() for line in head]
    for header, table, comment in tables:
        lines += [""] * bool(lines)
        if header:
            lines.append(header + (f"    # {comment}" if comment else ""))
        lines += [f"{key(name)} = {value(one)}" for name, one in table.items()]
    return "\n".join([*lines, ""])
