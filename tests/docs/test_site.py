"""The site of the docs builds without dead links, and asks nothing of a network."""

import re
import subprocess
import sys

import pytest

from tests.support.commands import ROOT

EXTERNAL = re.compile(r"<(?:script|link|img)[^>]*(?:src|href)=[\"']https?://[^\"']*")


@pytest.mark.slow
def test_the_site_builds():
    """mkdocs is strict: a link that leads nowhere ends it."""
    pytest.importorskip("mkdocs")
    command = [sys.executable, str(ROOT / "scripts" / "site.py")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    site = ROOT / "build" / "site"
    pages = {page: page.read_text(encoding="utf-8") for page in site.rglob("*.html")}
    assert len(pages) > 70 and not {str(page): EXTERNAL.findall(text) for page, text in pages.items()
                                    if EXTERNAL.search(text)}  # fmt: skip
    index = pages[site / "index.html"]
    for title in ("Start", "Tutorials", "How-to", "Explanation", "Reference", "Gallery", "Verification", "Performance"):
        assert title in index
    assert "Run.to_pyvista" in pages[site / "api.html"] and "<strong>Parameters</strong>" in pages[site / "api.html"]
    # the search finds without a server, too
    assert (site / "search" / "search_index.js").exists() and "assets/iframe-worker.js" in index
    scene = pages[site / "scene.html"]
    assert "{ error = 0.02, ... }" in scene
    assert all(f'id="{one}"' in scene for one in ("contacts", "load-steps", "output"))
    named = {str(page): re.findall(r"<a href=\"[^\"]*\">[\w/]+\.md</a>", text) for page, text in pages.items()}
    assert not {page: found for page, found in named.items() if found}, "links have titles, not names of files"
