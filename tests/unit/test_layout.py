"""The tests lie as the packages do, and share what they share in tests/support."""

import re
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
PACKAGE = TESTS.parent / "pcontact"
# of a test, or of what is beside one
IMPORT = re.compile(r"^\s*(?:from|import) (tests\.(?!support\b)[\w.]+|test_\w+)", re.MULTILINE)


def test_every_unit_test_has_its_module():
    """tests/unit/mesh/test_partition.py is about pcontact/mesh/partition.py, and so is test_partition_SUBJECT.py."""
    named = {path.relative_to(TESTS / "unit") for path in TESTS.glob("unit/*/**/test_*.py")}

    def modules(path):
        words = path.stem.split("_")[1:]
        return [PACKAGE / path.with_name("_".join(words[:k]) + ".py") for k in range(len(words), 0, -1)]

    wrong = [str(path) for path in named if not any(module.exists() for module in modules(path))]
    assert len(named) > 40 and not wrong, wrong


def test_no_test_imports_from_another_one():
    found = {path: IMPORT.findall(path.read_text()) for path in TESTS.rglob("*.py")}
    assert len(found) > 80 and not {str(path): names for path, names in found.items() if names}


# the rooms of the non-linear path
PATH = [*sorted((PACKAGE / "solve").rglob("*.py")), *sorted((PACKAGE / "stepping").glob("*.py")), PACKAGE / "build.py",
        *(PACKAGE / "contact" / name for name in ("active_set.py", "pair.py"))]  # fmt: skip
# a constant's number, or numbers
NUMBER = re.compile(r"^( *)([A-Z][A-Z_]+)(?:, [A-Z_, ]+)? = (?:[-\d.]|np\.|\{\d)", re.MULTILINE)
# its unit in brackets, what it means, and where its value comes from
DECLARED = re.compile(r" *# \[[^\]]+\] .*(?:Rows?: [a-z_, ]+|Table: [a-z]+|From: \w+)", re.DOTALL)


def declarations(path):
    """(name, value as it is written, comment above) of the constants of a module that are numbers."""
    lines = path.read_text().splitlines()
    for i, line in enumerate(lines):
        if NUMBER.match(line):
            first = i
            while lines[first - 1].lstrip().startswith("#"):
                first -= 1
            name, value = line.split(" = ", 1)
            yield name.strip(), value, "\n".join(lines[first:i])


def test_constants_of_the_nonlinear_path_have_unit_meaning_and_source():
    """One to a line; a row is a heuristic of the robustness table, or one of its families."""
    found = [(path.name, *entry) for path in PATH for entry in declarations(path)]
    assert len(found) > 40
    assert not [entry[:2] for entry in found if not DECLARED.match(entry[3])]
    table = (TESTS.parent / "docs" / "tables" / "robustness.md").read_text()
    rows = [(name, row.strip()) for _, name, _, text in found for row in re.findall(r"Rows?: ([a-z_, \n#]+)\.", text)]
    split = [(name, row.strip()) for name, group in rows for row in group.split(",")]
    assert len(split) > 15 and not [(name, row) for name, row in split if f"| {row} |" not in table]


def test_no_constant_of_the_nonlinear_path_has_two_meanings():
    names = [entry[0] for path in PATH for entry in declarations(path)]
    assert sorted(names) == sorted(set(names))
