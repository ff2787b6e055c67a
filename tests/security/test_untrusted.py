"""A folder of a stranger's traps: `--untrusted` reads it, and nothing else happens."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from test_hostile_folder import ran
from tests.traps import SHORT, TRAP, TRAPS

from commands import forked
from undeadzone.cli.untrusted import _restrict_files
from undeadzone.errors import InputError
from undeadzone.scenario.reader import read

HOSTILE = '../../x; $(touch RAN) `touch RAN` <script>\\"\\u001b[2J'


def signal(path: str) -> str:
    """The scenario with a reference from a file."""
    line = f'reference = {{ kind = "csv", path = "{path}" }}'
    rows = [row for row in SHORT.splitlines() if not row.startswith("reference")]
    return "\n".join([*rows, line])


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """A file outside of the stranger's folder."""
    path = tmp_path / "home" / "secret.csv"
    path.parent.mkdir()
    path.write_text("t,r\n0.0,1.0\n1.0,2.0\n")
    return path


@pytest.fixture
def folder(tmp_path: Path, secret: Path) -> Path:
    """The traps, by what they try."""
    here = tmp_path / "strange"
    here.mkdir()
    for name in TRAPS:  # 1 to 7: modules
        (here / f"{name}.py").write_text(TRAP)
    (here / "matplotlibrc").write_text("text.usetex: True\n")  # 8
    for name in ("short-results", "out", "s-ensemble"):  # 9 to 11: where results would go
        (here / name).symlink_to(secret.parent)
    scenarios = {
        "link": "linked.csv",  # 12
        "hard": "hard.csv",  # 13
        "absolute": str(secret),  # 14
        "above": "../home/secret.csv",  # 15
        "device": "/dev/zero",  # 16
        "own_memory": "/proc/self/mem",  # 17
        "pipe": "pipe.csv",  # 18
        "socket": "socket.csv",  # 19
        "itself": "a_folder",  # 20
        "loop": "loop.csv",  # 21
        "nul": "a\\u0000b",  # 22
        "long": "x" * 5000,  # 23
        "missing": "missing.csv",  # 24
    }
    for name, path in scenarios.items():
        (here / f"{name}.toml").write_text(signal(path))
    (here / "linked.csv").symlink_to(secret)
    os.link(secret, here / "hard.csv")
    os.mkfifo(here / "pipe.csv")
    with socket.socket(socket.AF_UNIX) as opened:
        before = os.getcwd()
        os.chdir(here)  # names of sockets are short
        opened.bind("socket.csv")
        os.chdir(before)
    (here / "a_folder").mkdir()
    (here / "loop.csv").symlink_to("loop.csv")
    hostile = SHORT.replace('"short"', f'"{HOSTILE}"') + f'units = {{ output = "{HOSTILE}" }}\n'
    (here / "hostile.toml").write_text(hostile)  # 25, 26
    endless = SHORT.replace("duration = 0.2", "duration = 1e9")  # 27
    (here / "endless.toml").write_text(endless)
    (here / "deep.toml").write_text("a = " + "[" * 100_000)  # 28
    (here / "large.toml").write_bytes(b"#" * 11_000_000)  # 29
    (here / "-rf.toml").write_text(SHORT)  # 30
    return here


REFUSED = (
    "link", "hard", "absolute", "above", "device", "own_memory", "pipe", "socket", "itself",
    "loop", "nul", "long", "missing", "endless", "deep", "large",
)  # fmt: skip


def run_forked(
    folder: Path, *arguments: str, stdin: bytes = b""
) -> subprocess.CompletedProcess[str]:
    """A command in a folder, in a copy of this process: the rights that it gives away are its."""
    done = forked(*arguments, cwd=folder, stdin=stdin)
    texts = done.stdout.decode(), done.stderr.decode()
    return subprocess.CompletedProcess(done.args, done.returncode, *texts)


def bomb(path: Path, megabytes: int) -> None:
    """A .mat file whose one element unpacks to so many zeros; a pass over them takes seconds."""
    savemat(path, {"t": np.zeros(1)}, do_compression=True)
    packer, million = zlib.compressobj(), bytes(10**6)
    first, again = (packer.compress(million) + packer.flush(zlib.Z_FULL_FLUSH) for _ in range(2))
    packed = first + (megabytes - 1) * again
    path.write_bytes(path.read_bytes()[:128] + struct.pack("<II", 15, len(packed)) + packed)


def test_no_trap_does_anything(folder: Path, secret: Path, tmp_path: Path) -> None:
    """Every scenario of the folder is refused, or runs and writes into --out alone."""
    for name in REFUSED:
        done = run_forked(folder, "check", f"{name}.toml", "--untrusted", ".", "--no-figures")
        assert done.returncode == 2, (name, done.stdout, done.stderr)
        assert len(done.stderr.splitlines()) == 1, done.stderr
        assert "secret" not in done.stderr.replace("home/secret.csv", "")
    out = tmp_path / "results"
    for name, *more in (["hostile.toml"], ["./-rf.toml", "--no-figures"]):
        done = ran(folder, "run", name, *more, "--untrusted", ".", "--out", str(out))
        assert done.returncode == 1, (name, done.stderr)  # an edge is never reached
        assert "\x1b" not in done.stdout
    bomb(folder / "bomb.mat", 560)  # 31
    done = ran(folder, "identify", "bomb.mat", "--untrusted", ".", "--out", str(out))
    assert done.returncode == 2
    assert "unpack" in done.stderr or "larger" in done.stderr
    assert {path.name for path in secret.parent.iterdir()} == {"secret.csv"}
    assert not list(tmp_path.rglob("RAN"))
    assert not list(out.glob(".scratch*"))
    assert {path.name for path in tmp_path.iterdir()} == {"home", "strange", "results"}


def test_every_command_that_reads_files_has_it(folder: Path) -> None:
    """It asks for --out before anything else."""
    for command in ("run", "check", "design", "ensemble", "tune", "estimate", "export", "arena"):
        more = ["run.csv"] if command == "estimate" else []
        done = run_forked(folder, command, "./-rf.toml", *more, "--untrusted", "nowhere")
        assert done.returncode == 2
        assert "--untrusted" in done.stderr, (command, done.stderr)


def test_a_link_in_the_place_of_results_is_not_followed(folder: Path, secret: Path) -> None:
    """Where the kernel has Landlock; nothing is written into the folder behind the link."""
    done = run_forked(folder, "run", "./-rf.toml", "--untrusted", ".", "--out", "results")
    assert done.returncode == 1
    assert {path.name for path in secret.parent.iterdir()} == {"secret.csv"}


def test_worker_processes_have_the_same_limits(folder: Path, tmp_path: Path) -> None:
    """Processes that a command starts have its limits; a contest runs as ever."""
    few = ("--methods", "kalman,oracle", "--seeds", "1", "--processes", "2")
    out = str(tmp_path / "a")
    done = ran(folder, "arena", "./-rf.toml", *few, "--untrusted", ".", "--out", out)
    assert done.returncode == 0, done.stderr
    assert not list(tmp_path.rglob("RAN"))


def test_a_scenario_beside_the_folder_is_not_read(folder: Path, secret: Path) -> None:
    """What the kernel takes away is bad input, not a mistake of the program."""
    other = secret.parent / "mine.toml"
    other.write_text(SHORT)
    done = run_forked(folder, "check", str(other), "--untrusted", ".", "--no-figures")
    landlock = sys.platform == "linux" and "no Landlock" not in done.stderr
    assert done.returncode == (2 if landlock else 1), done.stderr


def test_where_python_was_started_is_no_library(folder: Path, secret: Path) -> None:
    """`python -m` puts its working folder ahead of all others that modules come from."""
    (secret.parent / "log.csv").write_text("t,u,y\n0.0,1.0,0.5\n0.005,1.0,0.5\n0.01,1.0,0.6\n")
    (secret.parent / "up").mkdir()
    (secret.parent / "up" / "s.toml").write_text(SHORT)
    line = [sys.executable, "-m", "undeadzone", "estimate", "up/s.toml", "log.csv"]
    line += ["--untrusted", "up", "--no-figures"]
    done = subprocess.run(line, cwd=secret.parent, capture_output=True, text=True)
    if sys.platform == "linux" and "no Landlock" not in done.stderr:
        assert done.returncode == 2
        assert "log.csv: cannot read" in done.stderr


def test_files_with_further_names_are_refused_by_confine_too(folder: Path) -> None:
    with pytest.raises(InputError, match="the file has further names"):
        read(folder / "hard.toml", folder)


def test_a_system_without_landlock_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    assert not _restrict_files([Path.cwd()], [])


def test_a_page_and_a_state_are_written_beside_themselves(folder: Path, tmp_path: Path) -> None:
    """Where --out names a file, or a command makes but one, its folder is what is written."""
    page, state = tmp_path / "results" / "live.html", tmp_path / "kept" / "state.npz"
    result = run_forked(
        folder, "export", "./-rf.toml", "--to", "page", "--untrusted", ".", "--out", str(page)
    )
    assert result.returncode == 0, result.stderr
    assert page.is_file()
    lines = b"y,u\n0.5,1.0\n0.4,1.0\n"
    line = ("watch", "./-rf.toml", "--untrusted", ".", "--state", str(state))
    done = run_forked(folder, *line, stdin=lines)
    assert done.returncode in (0, 1), done.stderr
    assert state.is_file()
    assert len(done.stdout.splitlines()) == 3


def test_fonts_that_are_listed_nowhere_cost_no_words(folder: Path, tmp_path: Path) -> None:
    """Matplotlib keeps a list of them, in a folder that may not be written here."""
    words = ("run", "./-rf.toml", "--untrusted", ".", "--out", str(tmp_path / "results"))
    done = ran(folder, *words, MPLCONFIGDIR=str(tmp_path / "none"))
    assert done.returncode == 1
    assert not [line for line in done.stderr.splitlines() if not line.startswith("untrusted: ")]
    assert (tmp_path / "results" / "figure.svg").is_file()


def test_an_export_is_written_and_replaced(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where nothing but --out may be written, its own parent included."""
    refused = ran(folder, "export", "./-rf.toml", "--untrusted", ".", "--out", str(tmp_path / "no"))
    assert refused.returncode == 2  # CC of the tests stands where nothing may be run
    assert "the C compiler cannot be run" in refused.stderr
    monkeypatch.delenv("CC")
    out = tmp_path / "firmware"
    for place in (str(out), "../firmware"):
        done = ran(folder, "export", "./-rf.toml", "--untrusted", ".", "--out", place)
        assert done.returncode in (0, 1), done.stderr
    assert (out / "manifest.json").is_file()
    assert not [path for path in out.iterdir() if path.name.startswith(".")]
