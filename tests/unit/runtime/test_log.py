"""runtime/log.py: who speaks, where to, and in which form."""

import io

import pytest

from pcontact.runtime import log


@pytest.fixture
def stream():
    """A text stream; afterwards the logger is as it was before."""
    yield io.StringIO()
    log.setup()


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_rank_zero_speaks(stream):
    log.setup(0, stream)
    log.info("step %d", 3)
    log.warning("careful")
    log.debug("not shown")
    assert stream.getvalue() == "step 3\nwarning: careful\n"


def test_other_ranks_are_silent_unless_asked(stream):
    log.setup(1, stream)
    log.info("hello")
    log.error_line("wrong", stream)
    assert stream.getvalue() == ""
    log.setup(1, stream, all_ranks=True)
    log.info("hello")
    assert stream.getvalue() == "[1] hello\n"


def test_setup_again_does_not_double_lines(stream):
    log.setup(0, stream)
    log.setup(0, stream)
    log.info("once")
    assert stream.getvalue() == "once\n"


def test_unknown_level():
    with pytest.raises(ValueError, match="loud.*error, warning, info, debug"):
        log.setup(level="loud")


def test_error_is_one_line(stream):
    log.setup(0, stream)
    log.error_line("scene.toml: [mesh] ordre:\n  unknown key", stream)
    assert stream.getvalue() == "pcontact: error: scene.toml: [mesh] ordre: unknown key\n"


def test_a_terminal_obeys_no_name_of_a_file(stream):
    log.setup(0, stream)
    log.info("a\x1b]0;title\x07\tb\rc \x1b[32mgreen\x1b[0m\n\x9b")
    log.error_line("d\x1b[2J", stream)
    lines = r"a\x1b]0;title\x07", r"b\rc " + "\x1b[32mgreen\x1b[0m\n" + r"\x9b", r"pcontact: error: d\x1b[2J"
    assert stream.getvalue() == f"{lines[0]}\t{lines[1]}\n{lines[2]}\n"


def test_progress_in_a_file_is_plain_lines(stream):
    log.setup(0, stream)
    with log.Progress(2.0, "load", lines=4) as progress:
        for i in range(1, 21):
            progress.to(0.1 * i, f"step {i}")
    assert stream.getvalue().splitlines() == [
        "load 25 % step 5", "load 50 % step 10", "load 75 % step 15", "load 100 % step 20"]


def test_a_long_load_step_in_a_file(stream, monkeypatch):
    """Its residuals are a line where there was none for long."""
    log.setup(0, stream)
    with log.Progress(2.0, "load", lines=0) as progress:
        progress.say("residual 1e+00")
        monkeypatch.setattr(log, "IN_FILE", 0.0)
        with log.terse(set()):
            log.info("a line of a pass")
            progress.say("residual 1e+00 2e-01")
    log.setup(1, stream)
    with log.Progress(2.0, "load", lines=0) as progress:
        progress.say("of another rank")
    assert stream.getvalue() == "residual 1e+00 2e-01\n"


def test_progress_of_a_silent_rank(stream):
    log.setup(2, stream)
    with log.Progress(1.0) as progress:
        progress.to(1.0)
    assert stream.getvalue() == ""


def test_progress_on_a_terminal_is_a_bar(stream):
    terminal = Terminal()
    log.setup(0, terminal)
    with log.Progress(1.0, "load") as progress:
        progress.to(0.5, "newton 4")
        log.info("a line of its own")
        progress.to(1.0)
    text = terminal.getvalue()
    assert "load" in text and "|" in text
    assert "a line of its own\n" in text


def test_remarks_on_the_bar_and_colours(stream, monkeypatch):
    """What Newton's method is at, without a line of its own; colours on a terminal alone."""
    terminal = Terminal()
    log.setup(0, terminal)
    assert log.coloured("done", "green") == "\033[32mdone\033[0m"
    with log.Progress(2.0, "load", lines=0) as progress:
        progress.to(1.0)
        progress.say("step 2 to 2, residual 1e+02 3e-01")
    log.error_line("wrong", terminal)
    text = terminal.getvalue()
    assert "50%" in text and "left, step 2 to 2, residual 1e+02 3e-01" in text
    assert "\n" not in text.partition("wrong")[0]
    assert "\033[31mpcontact: error:\033[0m wrong\n" in text
    monkeypatch.setenv("NO_COLOR", "1")
    assert log.coloured("done", "green") == "done"
    log.setup(0, stream)
    with log.Progress(2.0, "load", lines=0) as progress:
        progress.say("step 2")
        progress.to(2.0)
    assert stream.getvalue() == "" and log.coloured("done", "green") == "done"
