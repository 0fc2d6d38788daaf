"""Run the notebooks of the examples and keep what their cells show.

    python scripts/notebooks.py            all of drivers/examples
    python scripts/notebooks.py FILE ...

The cells run one after the other, as in a kernel; pictures are those that a notebook would show.
"""

import ast
import base64
import io
import json
import re
import sys
from contextlib import redirect_stdout
from pathlib import Path

import matplotlib

matplotlib.use("agg")

import matplotlib.pyplot as plt  # noqa: E402
from PIL import Image  # noqa: E402

COLOURS = 64
EXAMPLES = Path(__file__).resolve().parents[1] / "drivers" / "examples"


def lines(text):
    """A text as notebooks have it."""
    return text.splitlines(keepends=True)


def shown(value):
    """What a notebook shows of a value: dict of a kind to its data."""
    # without the place in memory, which is another one in every run
    data = {"text/plain": lines(re.sub(r" at 0x[0-9a-f]+", "", repr(value)))}
    if callable(getattr(value, "_repr_html_", None)):
        data["text/html"] = lines(value._repr_html_())
    if callable(getattr(value, "_repr_png_", None)):
        data["image/png"] = packed(value._repr_png_())
    return data


def packed(picture):
    """A picture of few colours, which is a third as large, as text."""
    small = io.BytesIO()
    Image.open(io.BytesIO(picture)).convert("RGB").quantize(COLOURS).save(small, "PNG", optimize=True)
    return base64.b64encode(small.getvalue()).decode()


def figures():
    """Those of matplotlib that a cell has left, which are closed."""
    found = []
    for number in plt.get_fignums():
        drawn, figure = io.BytesIO(), plt.figure(number)
        figure.savefig(drawn, format="png", dpi=80)
        data = {"image/png": packed(drawn.getvalue()), "text/plain": [f"<Figure {number}>"]}
        found.append({"output_type": "display_data", "metadata": {}, "data": data})
    plt.close("all")
    return found


def run(path):
    """Run a notebook, and write it with its outputs."""
    book = json.loads(path.read_text(encoding="utf-8"))
    names, count = {}, 0
    for cell in book["cells"]:
        if cell["cell_type"] != "code":
            continue
        count, printed = count + 1, io.StringIO()
        tree = ast.parse("".join(cell["source"]))
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        with redirect_stdout(printed):
            exec(compile(tree, path.name, "exec"), names)
            value = None if last is None else eval(compile(ast.Expression(last.value), path.name, "eval"), names)
        outputs = []
        if printed.getvalue():
            outputs.append({"output_type": "stream", "name": "stdout", "text": lines(printed.getvalue())})
        if value is not None:
            outputs.append({"output_type": "execute_result", "execution_count": count, "metadata": {},
                            "data": shown(value)})  # fmt: skip
        cell["outputs"], cell["execution_count"] = [*outputs, *figures()], count
    path.write_text(json.dumps(book, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    for one in map(Path, sys.argv[1:] or sorted(EXAMPLES.glob("*.ipynb"))):
        run(one)
        print(f"{one} written")
