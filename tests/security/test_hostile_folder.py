"""The folder is the danger: modules, settings and files in it that strangers made."""

from __future__ import annotations

import errno
import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from tests.traps import COMMAND, SHORT, TRAP, TRAPS

from undeadzone.cli.ending import run_to_exit_code
from undeadzone.errors import FileError, InputError
from undeadzone.logs import whole
from undeadzone.scenario.reader import parse, read
from undeadzone.simulation.simulate import simulate
from undeadzone_export.exported_step import to_identifier
from undeadzone_export.exporting import export


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A working folder with a scenario and a stranger's modules and settings."""
    (tmp_path / "s.toml").write_text(SHORT)
    for name in TRAPS:
        (tmp_path / f"{name}.py").write_text(TRAP)
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\nfigure.facecolor: 00ff00\n")
    return tmp_path


def ran(folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A command in a folder."""
    line = [*COMMAND, *arguments]
    around = {**os.environ, **environment}
    return subprocess.run(line, cwd=folder, env=around, capture_output=True, text=True)


def test_no_process_of_a_contest_runs_modules_of_the_working_folder(folder: Path) -> None:
    """Neither its workers nor the tracker of what they share; few samples are drawn."""
    few = ("--methods", "kalman,ekf", "--seeds", "2", "--processes", "2")
    done = ran(folder, "arena", "s.toml", *few, "--html", "--out", "a")
    assert done.returncode == 0, done.stderr
    assert not (folder / "RAN").exists()
    assert not (folder / "a" / "results.json.partial").exists()
    assert (folder / "a" / "report.html").exists()


def test_figures_are_the_same_in_every_folder(
    folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Settings of a folder, and a backend that nobody has, change no pixel of the command line."""
    clean = tmp_path_factory.mktemp("clean")
    (clean / "s.toml").write_text(SHORT)
    for place, backend in ((folder, "nosuch"), (clean, "agg")):
        done = ran(place, "run", "s.toml", "--out", "r", MPLBACKEND=backend)
        assert done.returncode == 1, done.stderr  # an edge is never reached
    drawn = sorted((folder / "r").glob("*.svg"))
    assert drawn
    for picture in drawn:
        assert picture.read_bytes() == (clean / "r" / picture.name).read_bytes()
    assert not (folder / "RAN").exists()


def test_a_notebook_keeps_its_settings(folder: Path) -> None:
    """From Python the settings of the user's folder hold."""
    line = "import undeadzone, matplotlib; print(matplotlib.rcParams['figure.facecolor'])"
    done = subprocess.run(
        [sys.executable, "-P", "-c", line], cwd=folder, capture_output=True, text=True
    )
    assert "00ff00" in done.stdout, done.stderr


@pytest.mark.parametrize("title", ["math", "lambda", "Stdint"])
def test_a_title_names_no_module_header_or_word(title: str, tmp_path: Path) -> None:
    """It gets a letter in front; as a name that is asked for it is refused."""
    assert to_identifier(title) == f"n{title.lower()}"
    scenario = parse(SHORT.replace('"short"', f'"{title}"'))
    export(scenario, "arduino", tmp_path / "lib")
    assert not list((tmp_path / "lib").rglob(f"{title.lower()}.*"))
    with pytest.raises(InputError, match="are taken"):
        export(scenario, "c", tmp_path / "x", name=title.lower())
    assert not (tmp_path / "x").exists()


def test_a_cut_title_may_end_as_a_word() -> None:
    """Names are cut at 24 characters, and what remains may be one that is taken."""
    assert to_identifier(to_identifier("math" + "_" * 30 + "x")[:24]) == "math_x"
    assert to_identifier("math!") == "nmath"


def element(content: bytes) -> bytes:
    """A compressed element of a .mat file."""
    packed = zlib.compress(content, 9)
    return struct.pack("<II", 15, len(packed)) + packed


def test_a_mat_file_that_unpacks_to_more_than_a_log_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Counted, not believed: one element, many, in the order of bytes of either kind of machine."""
    path = tmp_path / "log.mat"
    savemat(path, {"t": np.arange(3.0), "y": np.zeros(3), "u": np.ones(3), "words": "abc"})
    assert {title.name for title, _ in whole.of_mat(path)} == {"t", "y", "u"}
    savemat(path, {"t": np.arange(3.0), "y": np.zeros(3)}, do_compression=True)
    assert len(whole.of_mat(path)) == 2
    monkeypatch.setattr(whole, "LARGEST_MATRICES", 3_000_000)
    savemat(path, {"t": np.zeros(1_000_000)}, do_compression=True)
    with pytest.raises(FileError, match="unpack to more"):
        whole.of_mat(path)
    head = path.read_bytes()[:128]
    path.write_bytes(head + 4 * element(bytes(1_000_000)))
    with pytest.raises(FileError, match="unpack to more"):
        whole.of_mat(path)
    savemat(path, {"t": np.zeros(4_000_000, np.int8)})
    with pytest.raises(FileError, match="larger than any log"):
        whole.of_mat(path)


@pytest.mark.parametrize("key", ["reference", "disturbance"])
def test_a_path_with_a_nul_is_bad_input(key: str, tmp_path: Path) -> None:
    signal = f'{key} = {{ kind = "csv", path = "a\\u0000b" }}\n'
    lines = [line for line in SHORT.splitlines() if not line.startswith(key)]
    path = tmp_path / "n.toml"
    path.write_text("\n".join([*lines, signal]))
    with pytest.raises(InputError, match=f"{key}.path: .*cannot read: .*null"):
        simulate(read(path))
    with pytest.raises(InputError, match=f"{key}.path: no path: it holds a NUL"):
        read(path, tmp_path)


def test_a_wrong_epoch_is_named(folder: Path) -> None:
    done = ran(folder, "run", "s.toml", SOURCE_DATE_EPOCH="x")
    assert done.returncode == 2
    assert done.stderr.startswith("undeadzone: SOURCE_DATE_EPOCH: expected whole seconds")


@pytest.mark.skipif(sys.platform == "win32", reason="no limits there")
def test_too_little_memory_is_no_mistake_of_the_program(folder: Path) -> None:
    """Refused before a library asks in vain, which may never come back."""
    line = ["sh", "-c", 'ulimit -v 250000; exec "$0" "$@"', *COMMAND, "run", "s.toml"]
    done = subprocess.run(line, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 2, done.stderr
    assert "memory ran out: 256 MB of addresses" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        OSError(errno.ENOMEM, "x"),
        ImportError("libz.so: failed to map segment from shared object"),
        RuntimeError("can't start new thread"),
    ],
)
def test_memory_that_runs_out_later_is_bad_input(
    error: Exception, capsys: pytest.CaptureFixture[str]
) -> None:
    def command() -> None:
        raise error

    assert run_to_exit_code(command) == 2
    assert "memory ran out" in capsys.readouterr().err
