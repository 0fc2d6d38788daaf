"""The tests lie as the packages do, and share what they share in tests/support."""

import re
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
PACKAGE = TESTS.parent / "pcontact"
# of a test, or of what is beside one
IMPORT = re.compile(r"^\s*(?:from|import) (tests\.(?!support\b)[\w.]+|test_\w+)", re.MULTILINE)


def test_every_unit_test_has_its_module():
    """tests/unit/mesh/test_partition.py is about pcontact/mesh/partition.py."""
    named = {path.relative_to(TESTS / "unit") for path in TESTS.glob("unit/*/**/test_*.py")}
    wrong = [str(path) for path in named if not (PACKAGE / path.with_name(path.name[len("test_") :])).exists()]
    assert len(named) > 40 and not wrong, wrong


def test_no_test_imports_from_another_one():
    found = {path: IMPORT.findall(path.read_text()) for path in TESTS.rglob("*.py")}
    assert len(found) > 80 and not {str(path): names for path, names in found.items() if names}
