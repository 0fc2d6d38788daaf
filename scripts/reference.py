"""Write the tables of the docs that follow from what the program declares: scene keys, options, presets.

    python scripts/reference.py            write them
    python scripts/reference.py --check    say which pages are not up to date; exit status 1 if there are any

A table stands between the lines ``<!-- table: NAME -->`` and ``<!-- end -->`` of a page.
"""

import re
import sys
from dataclasses import MISSING, fields
from pathlib import Path

from pcontact.io.names import FIELDS
from pcontact.io.report_schema import described
from pcontact.runtime.declared import shown
from pcontact.runtime.presets import PRESETS
from pcontact.scene.keys import keys
from pcontact.scene.model import HEADERS, Contact, Scene
from pcontact.usage import COMMANDS, run_options

ROOT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(r"(<!-- table: ([\w ]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def rows(head, lines):
    """A table of markdown."""
    cells = [head, ["---"] * len(head), *lines]
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in cells)


def code(value):
    """A value as code; words as they are."""
    return f"`{value}`"


def default_of(one):
    """What holds where a key or an option is not said."""
    if one.otherwise:
        return one.otherwise
    if one.default in (None, MISSING):
        return ""
    return code(f'"{one.default}"') if isinstance(one.default, str) and hasattr(one, "unit") else shown(one.default)


def range_of(one):
    """Type and range of a key's values, with their unit."""
    words = one.rule.allowed.partition(", pi, numbers")[0]  # of expressions; the page says the rest
    return words.replace(";", ",") + (f" [{one.unit}]" if one.unit else "")


def meaning(one):
    """Help and what the docs add to it."""
    between = ". " if one.more[:1].isupper() else "; "
    return one.help + (between + one.more if one.more else "")


def key_table(cls):
    """The keys of a table of the scene."""
    lines = [[code(name), range_of(one), default_of(one), meaning(one)] for name, one in keys(cls).items()]
    if cls is Contact:
        after = [field.name for field in fields(Contact)].index("obstacle")
        lines.insert(after, ["`obstacle`", "a table", "", "instead of `target`: a rigid body, see below"])
    return rows([code(HEADERS[cls]) if cls is not Scene else "top", "allowed", "default", ""], lines)


def option_table(options):
    """A table of options."""
    return rows(["option", "default", ""], [[code(one.usage), default_of(one), meaning(one)] for one in options])


def scene_options():
    """The options that replace keys of the scene."""
    title = next(iter(run_options()))
    homes = {one.option: (cls, name) for cls in HEADERS for name, one in keys(cls).items() if one.option}
    lines = []
    for one in run_options()[title]:
        cls, name = homes[one.name]
        home = f"`{name}` of {HEADERS[cls] if cls is Scene else code(HEADERS[cls])}"
        lines.append([code(one.usage), home, one.help + one.words])
    return rows(["option", "replaces", ""], lines)


def preset_table():
    """What presets of accuracy choose, and what holds without them."""
    names = dict.fromkeys(name for preset in PRESETS.values() for name in preset.options)
    without = {"snes_rtol": "1e-8", "contact_partner_rtol": "0.002"}
    lines = [["degree of the displacement, mesh of degree 2", *(str(one.order) for one in PRESETS.values()), "2"],
             ["load steps over those of the scene, where bodies rub or yield",
              *(str(one.steps) for one in PRESETS.values()), "1"]]  # fmt: skip
    for name in names:
        chosen = [shown(one.options.get(name, without[name])) for one in PRESETS.values()]
        lines.append([code(name), *chosen, without[name]])
    inexact = [f"{one.krylov:g}" if one.krylov else "as without" for one in PRESETS.values()]
    lines.append(["`snes_ksp_ew_rtol0`, `snes_ksp_ew_rtolmax`", *inexact,
                  "1e-3; in space, unless bodies may yield or contact is stiff, 1e-4"])  # fmt: skip
    linear = [f"{one.linear:g}" for one in PRESETS.values()]
    lines.append(["`ksp_rtol` where one linear solve is all", *linear, "1e-10"])
    return rows(["", *map(code, PRESETS), "without"], lines)


def field_table():
    """The fields that a run writes."""
    lines = [[code(one.name), one.place, one.unit, one.when, one.help] for one in FIELDS]
    return rows(["field", "of the", "unit", "where there is", ""], lines)


def report_table():
    """The keys of report.json."""
    lines = []
    for path, words in described():
        text, _, unit = words.rpartition(" [") if words.endswith("]") else (words, "", "")
        text, unit = ("", words[1:]) if words.startswith("[") else (text, unit)
        lines.append([code(path), f"[{unit}" if unit else "", text])
    return rows(["key", "unit", ""], lines)


def tables():
    """All tables by name."""
    own = {cls.__name__: key_table(cls) for cls in HEADERS}
    own |= {title: option_table(options) for title, options in list(run_options().items())[1:]}
    own |= {name: option_table(one.options.values()) for name, one in COMMANDS.items() if one.options}
    commands = [[code(f"pcontact {name} {one.usage}"), one.help] for name, one in COMMANDS.items()]
    own |= {"scene options": scene_options(), "presets": preset_table(), "fields": field_table()}
    return own | {"report": report_table(), "commands": rows(["", ""], commands)}


def main(words):
    """Write or check all pages; the exit status."""
    found, old = tables(), []
    for page in sorted(ROOT.glob("docs/**/*.md")):
        text = page.read_text(encoding="utf-8")
        new = BLOCK.sub(lambda match: match[1] + found[match[2]] + match[3], text)
        if new != text:
            old.append(page.relative_to(ROOT))
            if "--check" not in words:
                page.write_text(new, encoding="utf-8")
    for page in old:
        print(f"{page} {'is not up to date: python scripts/reference.py' if '--check' in words else 'written'}")
    return int(bool(old) and "--check" in words)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
