"""What drivers and scripts say of a fault goes through names that exist: the lines are rarely run."""

import ast
from pathlib import Path

import pytest

import drivers
from pcontact.runtime import log

ROOT = Path(drivers.__path__[0]).parent
FILES = sorted(path for folder in ("drivers", "scripts") for path in (ROOT / folder).rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_names_of_the_log_exist(path):
    nodes = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Attribute)]
    used = {node.attr for node in nodes if isinstance(node.value, ast.Name) and node.value.id == "log"}
    assert all(hasattr(log, name) for name in used), used
