"""Build the site of the docs into build/site, without a network.

    python scripts/site.py            pages, then the site (needs the extra `docs`: mkdocs-material)
    python scripts/site.py --pages    the pages only

Pages are those of docs/, the one of drivers/examples, and the Python API from its docstrings. Links to files beside
docs/ become their names: the site has no sources. Pages of docs/ that the navigation of mkdocs.yml does not name are
put below Tables, those of the verification manual beside its index.
"""

import inspect
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pcontact as pc

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "build" / "site_pages"
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")
# pages that stand elsewhere in the repository, and what they are called in the site
ELSEWHERE = {"drivers/examples/README.md": "examples.md"}
# Browsers start no workers from a disk; Material's search then takes a frame that acts as one, which this declares. The
# plugin `offline` would fetch one from a network, unless a file of this name is there.
WORKER = """\
if (location.protocol === "file:") {
  window.IFrameWorker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      // the program in the frame answers its parent, not itself
      frame.said = data => this.dispatchEvent(new MessageEvent("message", { data }));
      const script = (head, text) => `<script${head}>${text}</` + "script>";
      frame.srcdoc = script("", "postMessage = data => frameElement.said(data)") + script(` src="${url}"`, "");
      this.ready = new Promise(done => frame.addEventListener("load", () => done(frame.contentWindow)));
      document.body.append(frame);
    }
    postMessage(data) {
      this.ready.then(inside => inside.dispatchEvent(new inside.MessageEvent("message", { data })));
    }
  };
  window.Worker = window.IFrameWorker;
}
"""


def described(text):
    """A docstring as markdown: its sections are lists, of a name with its type and what is said of it."""
    lines, out, section = text.splitlines(), [], False
    for number, line in enumerate(lines):
        after = lines[number + 1] if number + 1 < len(lines) else ""
        if after and set(after) == {"-"}:
            section = True
            out += ["", f"**{line}**", ""]
        elif line and set(line) == {"-"}:
            continue
        elif section and line and not line.startswith(" "):
            name, colon, kind = line.partition(" : ")
            out.append(f"* `{name}`{f' ({kind})' if colon else ''}")
        else:
            # an indented line goes on with its point of the list
            out.append(("    " + line.strip() if line.strip() else "") if section else line)
    # code as markdown has it, references by their last name
    words = re.sub(r":\w+:`~?([\w.]+)`", lambda match: f"`{match[1].rpartition('.')[2]}`", "\n".join(out))
    return re.sub(r"``([^`]+)``", r"`\1`", words)


def call(name, one):
    """How something is called: on one line, or each argument on one of its own."""
    words = re.sub(r"(: |-> )'([^']*)'", r"\1\2", str(inspect.signature(one)))
    if len(words) > 80:
        parts = [re.sub(r"(: |-> )'([^']*)'", r"\1\2", str(one)) for one in inspect.signature(one).parameters.values()]
        words = "(\n    " + ",\n    ".join(parts) + ",\n)" + words[words.rindex(")") + 1 :]
    return f"{name}{words}"


def api_page():
    """The names of the Python API with their docstrings."""
    lines = ["# Python API", "", "[python.md](python.md) explains it.", ""]
    for name in sorted(n for n in dir(pc) if n in pc._HOMES):
        one = getattr(pc, name)
        try:
            words = call(name, one) if not inspect.isclass(one) or name == "Scene" else name
        except ValueError:
            words = name
        lines += [f"## {name}", "", "```python", words, "```", "", described(inspect.getdoc(one) or ""), ""]
        for method, made in vars(one).items() if inspect.isclass(one) else ():
            if not method.startswith("_") and (inspect.isfunction(made) or isinstance(made, property)) and made.__doc__:
                words = call(method, made) if inspect.isfunction(made) else method
                lines += [f"### {name}.{method}", "", "```python", words, "```", "",
                          described(inspect.cleandoc(made.__doc__)), ""]  # fmt: skip
    return "\n".join(lines)


def title(path):
    """The title of a page: of links whose words are the name of its file."""
    return path.read_text(encoding="utf-8").partition("\n")[0].lstrip("# ")


def rewritten(text, home, place):
    """A page's links as they are in the site.

    Parameters
    ----------
    text : str
    home : Path
        Where the page stands in the repository.
    place : Path
        Where it stands among the pages.
    """

    def link(match):
        target, _, anchor = match[3].partition("#")
        if not target or "://" in target:
            return match[0]
        path = (home.parent / target).resolve()
        name = ELSEWHERE.get(str(path.relative_to(ROOT)))
        if name is None and path.is_relative_to(ROOT / "docs") and path.is_file():
            name = str(path.relative_to(ROOT / "docs"))
        if name is None:
            return f"`{path.relative_to(ROOT)}`" if match[2].strip("`") == target else f"{match[2]}"
        up = "../" * (len(place.relative_to(PAGES).parts) - 1)
        words = title(path) if match[2].strip("`").endswith(".md") else match[2]
        return f"{match[1]}[{words}]({up}{name}{'#' + anchor if anchor else ''})"

    return LINK.sub(link, text)


def write_pages():
    """All pages into build/site_pages."""
    shutil.rmtree(PAGES, ignore_errors=True)
    shutil.copytree(ROOT / "docs", PAGES)
    for page in PAGES.rglob("*.md"):
        home = ROOT / "docs" / page.relative_to(PAGES)
        page.write_text(rewritten(page.read_text(encoding="utf-8"), home, page), encoding="utf-8")
    for home, name in ELSEWHERE.items():
        page = PAGES / name
        page.write_text(rewritten((ROOT / home).read_text(encoding="utf-8"), ROOT / home, page), encoding="utf-8")
    (PAGES / "assets").mkdir()
    (PAGES / "assets" / "iframe-worker.js").write_text(WORKER, encoding="utf-8")
    home = ROOT / "docs" / "api.md"
    (PAGES / "api.md").write_text(rewritten(api_page(), home, PAGES / "api.md"), encoding="utf-8")


def configuration():
    """mkdocs.yml, with the pages that it does not name."""
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    named = set(re.findall(r"[\w/]+\.md", text))
    missing = [str(page.relative_to(PAGES)) for page in sorted(PAGES.rglob("*.md"))
               if str(page.relative_to(PAGES)) not in named]  # fmt: skip
    path = ROOT / "build" / "mkdocs.yml"
    text = text.replace("docs_dir: build/", "docs_dir: ").replace("site_dir: build/", "site_dir: ")
    manual = [page for page in missing if page.startswith("verification/")]
    tables = [page for page in missing if page not in manual]
    text = text.replace("verification/index.md", ", ".join(["verification/index.md", *manual]))
    path.write_text(text.replace("[tables/performance.md]", str(["tables/performance.md", *tables])), encoding="utf-8")
    return path


def main(words):
    """Build; the exit status."""
    write_pages()
    path = configuration()
    if "--pages" in words:
        return 0
    return subprocess.run([sys.executable, "-m", "mkdocs", "build", "-q", "-f", str(path)]).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
