"""``pcontact import``: a scene with its mesh from a deck, or from a mesh with groups."""

from pathlib import Path

from pcontact.importer import toml
from pcontact.importer.findings import CHANGED, LEFT_OUT, NO_EFFECT, TAKEN
from pcontact.importer.groups import counted, write_mesh
from pcontact.importer.translate import translate
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import make_directory, replace_file
from pcontact.scene.reader import read_scene

SCENE, MESH, LIST = "scene.toml", "mesh.msh", "import.txt"
DECKS = (".inp",)


def import_file(path, directory=None):
    """Make a scene and its mesh of a deck. Serial.

    Parameters
    ----------
    path : str or pathlib.Path
    directory : str or pathlib.Path, optional
        Where `scene.toml`, `mesh.msh` and `import.txt` go; absent: a directory with the name of the file.

    Returns
    -------
    int
        Exit status: 0, or 1 where something of the deck was left out.

    Raises
    ------
    InputError
        The deck cannot be read.
    OutputError
    """
    path = Path(path)
    if path.suffix.lower() not in DECKS:
        raise InputError(f"{path}: found {path.suffix!r} as the type of the file; allowed: {', '.join(DECKS)}")
    directory = path.with_suffix("") if directory is None else Path(directory)
    done = translate(path, MESH)
    findings = done.findings
    make_directory(directory)
    write_mesh(directory / MESH, done.deck, done.groups)
    for tool in done.tools:
        tool.write(directory)
    scene = directory / SCENE
    head = [f"From {path.name} by pcontact import; {LIST} says what became of every line."]
    if not findings.complete:
        head += ["Not all of the deck is here:"]
        head += [f"  {place}: {title}: {words}" for _, place, title, words in findings.of(LEFT_OUT)]
    replace_file(scene, toml.text(done.tables, head))
    replace_file(directory / LIST, "\n".join([f"{path}", "", *findings.lines(), ""]))
    read_scene(scene)
    for line in findings.lines((LEFT_OUT, CHANGED)):
        log.info("%s", line)
    counts = ", ".join(f"{len(findings.of(kind))} {kind}" for kind in (TAKEN, NO_EFFECT, CHANGED, LEFT_OUT))
    mesh = counted(done.deck, done.groups)
    log.info("wrote %s, %s (%s), %s: %s", scene, directory / MESH, mesh, directory / LIST, counts)
    return 0 if findings.complete else 1
