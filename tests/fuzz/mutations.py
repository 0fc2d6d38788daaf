"""Damage to scenes, meshes and HDF5 files: each function changes a file in place and says what it has done."""

import h5py
import numpy as np

# -- scenes ------------------------------------------------------------------------------------------------

ODD = ["nan", "inf", "-inf", "1e300", "-1e300", "1e-300", "1e-320", "0", "-0.0", "-1", "1e17",
       "123456789012345678901234567890", '""', '"text"', "true", "[]", "[[]]", "{ }", "1979-05-27",
       '"' + "x" * 1000 + '"', '"\u00e4\u2603\U0001f600"', '"\\u0000"',
       '"/dev/null"', '"../.."', "[1, 2, 3, 4]", "[nan, nan]", '"free"', "0x7fffffffffffffff", "0.5", "2"]  # fmt: skip


def _value_changed(rng, text):
    """A value replaced by something odd, or by a number near it."""
    lines = text.splitlines()
    rows = [k for k, line in enumerate(lines) if " = " in line]
    k = int(rng.choice(rows))
    key, _, old = lines[k].partition(" = ")
    if rng.random() < 0.3:
        pieces = [p for p in old.replace("[", " ").replace("]", " ").replace(",", " ").split() if _is_number(p)]
        if pieces:
            piece = str(rng.choice(pieces))
            new = repr(float(piece) * float(rng.choice([0.9, 1.1, -1.0, 1e12, 1e-12])))
            if "." not in piece and "e" not in piece:
                new = str(int(piece) + int(rng.choice([-1, 1, 3])))
            lines[k] = f"{key} = {old.replace(piece, new, 1)}"
            return "\n".join(lines), f"{key}: {piece} becomes {new}"
    new = str(rng.choice(ODD))
    if key.strip() == "count" and _is_number(new) and 50 < float(new) <= 1e6:
        new = "0"
    if "[" in old and rng.random() < 0.5 and _is_number(new):
        new = "[" + ", ".join([new] * max(1, old.count(",") + 1)) + "]"
    lines[k] = f"{key} = {new}"
    return "\n".join(lines), f"{key}: {old[:40]} becomes {new[:40]}"


def _is_number(word):
    try:
        float(word)
    except ValueError:
        return False
    return True


def _line_changed(rng, text):
    """A line removed, doubled, moved, or a new key."""
    lines = text.splitlines()
    k, kind = int(rng.integers(len(lines))), str(rng.choice(["removed", "doubled", "moved", "new", "long", "table"]))
    line = lines[k]
    if kind == "removed":
        del lines[k]
    elif kind == "doubled":
        lines.insert(k, line)
    elif kind == "moved":
        del lines[k]
        lines.insert(int(rng.integers(len(lines) + 1)), line)
    elif kind == "new":
        line = str(rng.choice(["no_such_key = 1", "__class__ = 1", "\u00e4 = 2", "E = 1.0", '"" = 3', "friction = 0.1",
                               "region = 'x'"]))  # fmt: skip
        lines.insert(k, line)
    elif kind == "long":
        line = "k" * 5000 + " = 1"
        lines.insert(k, line)
    else:
        line = str(rng.choice(["[materials]", "[mesh]", "[[bodies]]", "[[contacts]]", "[steps]", "[petsc]", "[nothing]",
                               "[materials.low]", "[[mesh]]", "[bodies]"]))  # fmt: skip
        lines.insert(k, line)
    return "\n".join(lines), f"line {k} {kind}: {line[:60]}"


def _bytes_changed(rng, data, most=4):
    """Bytes flipped, cut off, put in."""
    kinds = ["flipped", "cut off", "put in", "removed"]
    data, kind = bytearray(data), str(rng.choice(kinds, p=[0.55, 0.15, 0.15, 0.15]))
    at = int(rng.integers(len(data)))
    if kind == "flipped":
        for _ in range(int(rng.integers(1, most))):
            data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    elif kind == "cut off":
        del data[at:]
    elif kind == "put in":
        data[at:at] = rng.integers(0, 256, int(rng.integers(1, 20)), dtype=np.uint8).tobytes()
    else:
        del data[at : at + int(rng.integers(1, 200))]
    return bytes(data), f"bytes {kind} at {at}"


def scene_mutated(rng, folder):
    """Change scene.toml in a folder; what was done."""
    path = folder / "scene.toml"
    data = path.read_bytes()
    if rng.random() < 0.15:
        new, text = _bytes_changed(rng, data)
    else:
        change = _value_changed if rng.random() < 0.7 else _line_changed
        new, text = change(rng, data.decode())
        new = new.encode()
    path.write_bytes(new)
    return text


# -- meshes ------------------------------------------------------------------------------------------------


def _section(lines, name):
    return lines.index(f"${name}"), lines.index(f"$End{name}")


def _counts(rng, lines):
    name = str(rng.choice(["PhysicalNames", "Nodes", "Elements"]))
    k = _section(lines, name)[0] + 1
    words = lines[k].split()
    w = int(rng.integers(len(words)))
    new = str(rng.choice([str(int(words[w]) - 1), str(int(words[w]) + 1), "0", "-1", "1000000000000", "x", "", "2.5"]))
    text, words[w] = f"count {w} of {name}: {words[w]} becomes {new!r}", new
    lines[k] = " ".join(words)
    return text


def _word(rng, lines, name, choices):
    first, end = _section(lines, name)
    rows = [k for k in range(first + 2, end) if lines[k].split()]
    k = int(rng.choice(rows))
    words = lines[k].split()
    w = int(rng.integers(len(words)))
    new = str(rng.choice(choices))
    text, words[w] = f"{name}, line {k - first}: {words[w]} becomes {new!r}", new
    lines[k] = " ".join(words)
    return text


def _renamed(rng, lines):
    first, end = _section(lines, "PhysicalNames")
    k = int(rng.integers(first + 2, end))
    head, _, name = lines[k].partition('"')
    other = lines[int(rng.integers(first + 2, end))].partition('"')[2].rstrip('"')
    new = str(rng.choice(["", "x", "y" * 1000, "\u00e4 \u2603", "low", other, 'a"b', " "]))
    lines[k] = f'{head}"{new}"'
    return f"group {name.rstrip(chr(34))} becomes {new[:20]!r}"


def _cell(rng, lines):
    first, end = _section(lines, "Elements")
    rows = [k for k in range(first + 2, end) if len(lines[k].split()) > 4]
    k, kind = int(rng.choice(rows)), str(rng.choice(["inverted", "degenerate", "removed", "doubled"]))
    words = lines[k].split()
    if kind == "inverted":
        words[-1], words[-2] = words[-2], words[-1]
    elif kind == "degenerate":
        words[-1] = words[-2]
    lines[k] = " ".join(words)
    if kind == "removed":
        del lines[k]
    if kind == "doubled":
        lines.insert(k, lines[k])
    return f"element in line {k - first} {kind}"


def mesh_mutated(rng, folder):
    """Change the mesh that scene.toml names; what was done."""
    kind = str(rng.choice(["mesh", "mesh", "text4", "binary4", "binary2"]))
    path = folder / "mesh.msh"
    data = (folder / f"{kind}.msh").read_bytes()
    if kind.startswith("binary") or rng.random() < 0.3:
        new, text = _bytes_changed(rng, data)
        path.write_bytes(new)
        return f"{kind}.msh, {text}"
    lines = data.decode().splitlines()
    numbers = ["nan", "inf", "1e300", "-1e308", "0", "1e-300", "1.5", "x", "-1", "99999999999999999999", "3"]
    choice = rng.random()
    if choice < 0.25:
        text = _counts(rng, lines)
    elif choice < 0.45:
        text = _word(rng, lines, "Nodes", numbers)
    elif choice < 0.6:
        text = _word(rng, lines, "Elements", ["0", "1", "2", "-3", "4", "15", "999", "x", "nan", "9" * 20])
    elif choice < 0.75:
        text = _renamed(rng, lines)
    elif choice < 0.9:
        text = _cell(rng, lines)
    else:
        k = int(rng.integers(len(lines)))
        text = f"line {k} removed: {lines.pop(k)[:40]}"
    path.write_text("\n".join([*lines, ""]))
    return f"{kind}.msh, {text}"


# -- HDF5 --------------------------------------------------------------------------------------------------


def _datasets(file):
    found = []
    file.visititems(lambda name, node: found.append(name) if isinstance(node, h5py.Dataset) else None)
    return found


def _other(rng, value):
    """Another value for an attribute."""
    if isinstance(value, (str, bytes)):
        return "x"
    return type(value)(rng.choice([0, 1, 2, -1, 7])) if rng.random() < 0.5 else value + type(value)(1)


def hdf5_mutated(rng, path):
    """Change an HDF5 file; what was done."""
    before = path.read_bytes()
    for _ in range(20):
        text = _hdf5_mutated(rng, path)
        if path.read_bytes() != before and text is not None:
            return text
        path.write_bytes(before)
    raise AssertionError(f"{path} was not changed")


def _hdf5_mutated(rng, path):
    if rng.random() < 0.4:
        new, text = _bytes_changed(rng, path.read_bytes())
        path.write_bytes(new)
        return text
    with h5py.File(path, "r+") as file:
        name = str(rng.choice(_datasets(file)))
        kind = str(rng.choice(["value", "removed", "rows", "attribute", "attribute removed", "short"]))
        if kind.startswith("attribute"):
            holders = [node for node in ["/", name, *map(str, file)] if len(file[node].attrs)]
            holder = file[str(rng.choice(holders))]
            key = str(rng.choice(list(holder.attrs)))
            if kind == "attribute removed":
                del holder.attrs[key]
                return f"attribute {key} of {holder.name} removed"
            old = holder.attrs[key]
            if np.ndim(old):
                return None
            new = _other(rng, old)
            if new == old:
                return None
            holder.attrs[key] = float("nan") if isinstance(old, float) and rng.random() < 0.3 else new
            return f"attribute {key} of {holder.name}: {old} becomes {holder.attrs[key]}"
        old = file[name][()]
        if kind == "removed":
            del file[name]
            return f"{name} removed"
        if np.size(old) == 0 or np.ndim(old) == 0:
            return None
        new = old.copy()
        if kind == "rows":
            new[rng.integers(len(new))] = old[rng.integers(len(old))]
        elif kind == "short":
            new = old[:-1]
        else:
            at = tuple(int(rng.integers(n)) for n in new.shape)
            new[at] = float(rng.choice([np.nan, np.inf, 1e300, 0.0])) if new.dtype.kind == "f" else new[at] + 1
        if new.shape == old.shape and new.tobytes() == old.tobytes():
            return None
        attributes = dict(file[name].attrs)
        del file[name]
        file[name] = new
        file[name].attrs.update(attributes)
        return f"{name}: {kind}"
