"""How a command ends: its own code and one line for every end, closed streams and signals too."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import click
import pytest
from tests.jobs import stop_program

from commands import COMMAND
from documents import EXAMPLES
from undeadzone.cli import ending, group
from undeadzone.cli.ending import name_options, run_to_exit_code
from undeadzone.errors import InputError, Terminated


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    """A scenario without title and units, of which a run takes little."""
    text = (EXAMPLES / "asymmetric_noise.toml").read_text(encoding="utf-8")
    lines = []
    for line in text.splitlines():
        if line == "[units]":
            break
        if line.startswith("title"):
            continue
        lines.append("duration = 1.0" if line.startswith("duration") else line)
    path = tmp_path / "mine.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def as_before() -> None:
    """Leave the signals of this process as they were."""
    names = ("SIGTERM", "SIGHUP")
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = [signal.getsignal(number) for number in numbers]
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


def raising(error: BaseException) -> Callable[[], None]:
    def command() -> None:
        raise error

    return command


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (InputError("plant.A: wrong"), 2, "undeadzone: plant.A: wrong\n"),
        (click.UsageError("no such option"), 2, "undeadzone: no such option\n"),
        (KeyboardInterrupt("3 kept"), 130, "undeadzone: interrupted: 3 kept\n"),
        (KeyboardInterrupt(), 130, "undeadzone: interrupted\n"),
        (Terminated("3 kept"), 143, "undeadzone: terminated: 3 kept\n"),
        (Terminated(), 143, "undeadzone: terminated\n"),
        (InputError("a\nundeadzone: b\x1b[2J"), 2, "undeadzone: a\\nundeadzone: b\\x1b[2J\n"),
    ],
)
def test_every_end_has_its_code_and_its_line(
    capfd: pytest.CaptureFixture[str], error: BaseException, code: int, words: str
) -> None:
    assert run_to_exit_code(raising(error)) == code
    assert capfd.readouterr().err == words


ENDINGS = {signal.SIGINT: ("interrupted", 130), signal.SIGTERM: ("terminated", 143)}
FIRST = "as modules are imported"
WHEN = {
    FIRST: "import builtins\nreal = builtins.__import__\n"
    "def bring(name, *more):\n"
    "    if name == 'undeadzone.cli.run' and not SENT:\n"
    "        send()\n"
    "    return real(name, *more)\n"
    "builtins.__import__ = bring\n",
    "as an object is deleted": "class Last:\n    def __del__(self):\n        send()\n"
    "def run():\n    Last()\n    time.sleep(5)\n"
    "import undeadzone.cli as cli\n"
    "cli.group.main = lambda standalone_mode: run()\n",
    "as Python ends": "import atexit\nimport undeadzone.cli as cli\n"
    "cli.group.main = lambda standalone_mode: atexit.register(send) and 0\n",
}


# The system itself ends a process that SIGTERM reaches before it has begun.
MOMENTS = [(when, number) for when in WHEN for number in ENDINGS if (when, number) != (FIRST, 15)]


@pytest.mark.parametrize(("when", "number"), MOMENTS)
def test_a_signal_at_any_time_is_one_line(when: str, number: int) -> None:
    code = (
        "import os, signal, sys, time\nSENT = []\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"def send():\n    SENT.append(1)\n    os.kill(os.getpid(), {int(number)})\n"
        f"{WHEN[when]}from undeadzone.__main__ import main\nsys.argv[1:] = ['--version']\nmain()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    word, exit_code = ENDINGS[number]
    assert (done.returncode, done.stderr) == (exit_code, f"undeadzone: {word}\n")


def test_ctrl_c_within_a_command_is_one_line() -> None:
    """Click prints an empty line ahead of it, of what it knows to be Ctrl-C."""
    code = (
        "import signal, sys\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from undeadzone import cli\n"
        "cli.init.callback = lambda **given: signal.raise_signal(signal.SIGINT)\n"
        "sys.argv[1:] = ['init']\ncli.main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "undeadzone: interrupted\n")


@pytest.mark.parametrize(
    "error",
    [TypeError("a\nb"), ValueError(), RecursionError("deep"), AssertionError()],
)
def test_an_unexpected_exception_is_one_line_and_its_own_code(
    capfd: pytest.CaptureFixture[str], error: Exception
) -> None:
    assert run_to_exit_code(raising(error)) == 70
    stderr_text = capfd.readouterr().err
    assert stderr_text.count("\n") == 1
    assert "internal error at test_ending.py:" in stderr_text
    assert type(error).__name__ in stderr_text
    assert "UNDEADZONE_DEBUG=1" in stderr_text


def test_an_error_of_the_system_is_not_blamed_on_stdout(
    capfd: pytest.CaptureFixture[str],
) -> None:
    assert run_to_exit_code(raising(OSError(5, "Input/output error"))) == 70
    assert "Input/output error" in capfd.readouterr().err


def test_the_traceback_is_printed_on_request(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(ending.DEBUG, "1")
    assert run_to_exit_code(raising(TypeError("odd"))) == 70
    assert "Traceback (most recent call last)" in capfd.readouterr().err


def test_a_reader_who_has_seen_enough_is_no_failure(capfd: pytest.CaptureFixture[str]) -> None:
    read, write = os.pipe()
    os.close(read)
    with pytest.MonkeyPatch.context() as patch, os.fdopen(write, "w") as unread:
        patch.setattr(sys, "stdout", unread)
        assert run_to_exit_code(lambda: group.main(["run", "--help"], standalone_mode=False)) == 0
    assert not capfd.readouterr().err


def test_a_broken_pipe_of_another_is_an_error(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    work = click.Command("work", callback=raising(BrokenPipeError(32, "Broken pipe")))
    monkeypatch.setitem(group.commands, "work", work)
    assert run_to_exit_code(lambda: group.main(["work"], standalone_mode=False)) == 70
    assert "BrokenPipeError" in capfd.readouterr().err


def closing(*descriptors: int) -> Callable[[], None]:
    """What closes streams in a new process."""

    def close() -> None:
        for descriptor in descriptors:
            os.close(descriptor)

    return close


def run(
    *arguments: object, closed: tuple[int, ...] = (), environment: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """A command with some of its streams closed."""
    return subprocess.run(
        [*COMMAND, *map(str, arguments)],
        preexec_fn=closing(*closed),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, **(environment or {})},
    )


def test_a_run_needs_no_stdin_and_no_stderr(scenario: Path) -> None:
    out = scenario.parent / "out"
    done = run("run", scenario, "--no-figures", "--out", out, closed=(0, 2))
    assert done.returncode in (0, 1)
    assert "rms z - r" in done.stdout
    assert sorted(path.name for path in out.iterdir()) == ["run.csv", "run.npz"]


def test_a_closed_stdout_is_refused_before_anything_is_computed(scenario: Path) -> None:
    out = scenario.parent / "out"
    done = run("run", scenario, "--no-figures", "--out", out, closed=(0, 1))
    assert done.returncode == 2
    assert done.stderr.startswith("undeadzone: stdout is closed")
    assert done.stderr.count("\n") == 1
    assert not out.exists()


def test_a_closed_stdin_is_one_line(scenario: Path) -> None:
    done = run("watch", scenario, closed=(0,))
    assert done.returncode == 2
    assert done.stderr == "undeadzone: stdin: it is closed. Give lines of readings and inputs\n"


def test_a_terminal_of_few_characters_is_no_error(scenario: Path) -> None:
    text = scenario.read_text(encoding="utf-8")
    scenario.write_text(f'title = "größer ±"\n{text}', encoding="utf-8")
    done = run("run", scenario, "--no-figures", environment={"PYTHONIOENCODING": "ascii"})
    assert done.returncode in (0, 1)
    assert done.stderr == ""


STOPPED = """
import sys, time
from undeadzone.cli.ending import run_to_exit_code
from undeadzone_studies.ensemble import run_blocks
import functools, pathlib
from tests.jobs import say, sines

def command():
    make, path = functools.partial(sines, 605, 0.05), pathlib.Path(sys.argv[1])
    run_blocks.compute_job(make, path, workers=int(sys.argv[2]) or None, progress=say)

if __name__ == "__main__":
    sys.exit(run_to_exit_code(command))
"""


@pytest.mark.parametrize("workers", [0, 2])
def test_sigterm_reports_what_is_stored(tmp_path: Path, workers: int) -> None:
    path = tmp_path / "runs.partial"
    status, _, stderr_text = stop_program(signal.SIGTERM, STOPPED, path, workers)
    assert status == 143
    assert stderr_text.startswith("undeadzone: terminated: ")
    assert stderr_text.endswith(f"0 of 605 runs are kept in {path}; continue with --resume\n")
    assert stderr_text.count("\n") == 1


def test_sigterm_stays_ignored_where_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    assert run_to_exit_code(lambda: os.kill(os.getpid(), signal.SIGTERM)) == 0


@pytest.mark.parametrize("text", [r"$\\frac$ and $", r"cost $5 a\\$b"])
def test_dollars_in_a_title_lose_no_report(scenario: Path, text: str) -> None:
    content = scenario.read_text(encoding="utf-8")
    units = f'\n[units]\noutput = "{text}"\n'
    scenario.write_text(f'title = "{text}"\n{content}{units}', encoding="utf-8")
    out = scenario.parent / "out"
    done = run("run", scenario, "--out", out)
    assert done.returncode in (0, 1)
    assert done.stderr == ""
    assert {path.name for path in out.iterdir()} >= {"figure.svg", "report.html"}


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        ("kept; continue with resume=True", "kept; continue with --resume"),
        ('by columns="y=NAME,u=NAME"', "by --columns y=NAME,u=NAME"),
        ("shown by replay=NUMBER; a", "shown by --replay NUMBER; a"),
        ("columns: y is named twice", "columns: y is named twice"),
    ],
)
def test_messages_name_options_for_arguments(message: str, expected: str) -> None:
    assert name_options(message) == expected
