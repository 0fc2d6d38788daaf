"""Settings whose answers may be wrong: refused, or run with a warning where the scene says so."""

from pcontact.runtime import log
from pcontact.runtime.messages import input_error
from pcontact.scene.model import Scene


def unsafe(scene: Scene, word: str, key: str, found: str, allowed: str) -> None:
    """Refuse a setting, or warn of it if ``allow_unsafe`` has the word. All ranks must agree on the setting.

    Parameters
    ----------
    scene : Scene
    word : str
        Of `pcontact.scene.model.UNSAFE`.
    key : str
        Where it stands in the scene.
    found, allowed : str
        What the message says.

    Raises
    ------
    InputError
        Unless it is allowed.
    """
    if word not in scene.allow_unsafe:
        raise input_error(scene.where, key, found, f"{allowed}; -allow_unsafe {word} runs it all the same")
    log.warning("%s: found %s; safe: %s", key, found, allowed)
