"""Edges that nobody fuzzed: registered packages, long keys, links out of a stranger's folder."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

import undeadzone as uz
from documents import EXAMPLES
from undeadzone.util.toml import require_short_keys

CALL = [sys.executable, "-c", "from undeadzone.cli import main; main()"]
EXAMPLE = EXAMPLES / "asymmetric_noise.toml"


def call(*words: object, site: Path | None = None) -> subprocess.CompletedProcess[str]:
    environment = os.environ | ({} if site is None else {"PYTHONPATH": str(site)})
    command = [*CALL, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, env=environment)


def test_a_registered_package_that_fails_is_named(tmp_path: Path) -> None:
    info = tmp_path / "e-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: e\nVersion: 1\n")
    (info / "entry_points.txt").write_text(
        "[undeadzone.commands]\nbad = nosuch:cmd\n[undeadzone.observers]\nmine = e_mod:K\n"
    )
    (tmp_path / "e_mod.py").write_text("class K: pass\n")
    result = call("--help", site=tmp_path)
    assert result.returncode == 0
    assert "'bad' is registered at nosuch:cmd, which fails" in result.stderr
    assert "identify" in result.stdout
    assert call("bad", site=tmp_path).returncode == 2
    scenario = tmp_path / "m.toml"
    scenario.write_text('[observer]\nmethod = "mine"\n')
    done = call("run", scenario, "--no-figures", site=tmp_path)
    assert done.returncode == 2
    assert "not a class of options" in done.stderr


def test_a_package_that_ends_python_or_is_damaged_is_left_out(tmp_path: Path) -> None:
    """Its module exits where it is imported; of another one the entry points cannot be read."""
    for name, points in {
        "e": "[undeadzone.commands]\nbad = e_mod:cmd\n",
        "f": "[undeadzone.commands]\nnonsense\n",
    }.items():
        info = tmp_path / f"{name}-1.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n")
        (info / "entry_points.txt").write_text(points)
    (tmp_path / "e_mod.py").write_text("raise SystemExit(3)\n")
    done = call("--help", site=tmp_path)
    assert done.returncode == 0
    assert "'bad' is registered at e_mod:cmd, which fails: 3. It is left out" in done.stderr
    assert "f: its entry points cannot be read. It is left out" in done.stderr
    assert "identify" in done.stdout


@pytest.mark.parametrize("key", ["x" + ".a" * 20_000, "x" + '."a"' * 20_000, "x" + " . a" * 9_000])
def test_a_key_of_very_many_parts_is_refused_at_once(key: str) -> None:
    began = time.perf_counter()
    with pytest.raises(uz.InputError, match="line 2: a dotted key of more than 64 parts"):
        require_short_keys(f"\n{key} = 1")
    for harmless in ("a" * 1_000_000, '"' * 1_000_000, "a " * 500_000, "1.5*" * 250_000):
        assert require_short_keys(harmless) == harmless
    assert time.perf_counter() - began < 5


@pytest.mark.parametrize("kind", ["link", "hard"])
def test_a_log_that_leads_out_is_refused_and_not_quoted(tmp_path: Path, kind: str) -> None:
    folder, secret = tmp_path / "up", tmp_path / "secret"
    folder.mkdir()
    secret.write_text("SECRET=tok3n\n")
    log = folder / "l.csv"
    log.symlink_to(secret) if kind == "link" else log.hardlink_to(secret)
    done = call("identify", log, "--untrusted", folder, "--no-figures", "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "untrusted folder" in done.stderr
    assert "tok3n" not in done.stderr


def test_an_out_that_leads_out_is_refused(tmp_path: Path) -> None:
    folder, home = tmp_path / "up", tmp_path / "home"
    folder.mkdir()
    home.mkdir()
    (folder / "s.toml").write_text(EXAMPLE.read_text(encoding="utf-8"), encoding="utf-8")
    (folder / "results").symlink_to(home)
    done = call("run", folder / "s.toml", "--untrusted", folder, "--out", folder / "results")
    assert done.returncode == 2
    assert not list(home.iterdir())


def test_modules_of_a_strangers_folder_are_refused(tmp_path: Path) -> None:
    (tmp_path / "click.py").write_text("open('RAN', 'w')\n")
    words = ["-m", "undeadzone", "run", "s.toml", "--untrusted", ".", "--out", "o"]
    done = subprocess.run([sys.executable, *words], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2
    assert "python -P -m" in done.stderr
    assert not (tmp_path / "RAN").exists()


def test_an_ensemble_of_a_stranger_takes_little_disk(tmp_path: Path) -> None:
    scenario = tmp_path / "up" / "s.toml"
    scenario.parent.mkdir()
    text = EXAMPLE.read_text(encoding="utf-8")
    more = '[ensemble]\nruns = 20000000\n"sensor.right" = { uniform = [0.5, 1.5] }\n'
    scenario.write_text(f"{text}\n{more}", encoding="utf-8")
    out = tmp_path / "out"
    words = ("ensemble", scenario, "--untrusted", scenario.parent, "--no-figures", "--out", out)
    done = call(*words)
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert sum(path.stat().st_size for path in out.rglob("*") if path.is_file()) < 5e8


def short_scenario(path: Path) -> Path:
    """A scenario whose run takes little."""
    text = EXAMPLE.read_text(encoding="utf-8")
    path.write_text(re.sub(r"duration = .*", "duration = 0.5", text), encoding="utf-8")
    return path


@pytest.mark.parametrize("command", ["run", "estimate"])
def test_a_users_table_is_not_replaced(tmp_path: Path, command: str) -> None:
    """One of our own is, until someone edits it; with --force each is."""
    scenario, out, log = short_scenario(tmp_path / "s.toml"), tmp_path / "out", tmp_path / "log.csv"
    step = uz.read(scenario).simulation.step
    rows = [f"{step * k!r},{k % 7 - 3},0.5" for k in range(50)]
    log.write_text("\n".join(["t,u,y", *rows]) + "\n")
    words = [command, scenario, *([log] if command == "estimate" else [])]
    words += ["--no-figures", "--out", out]
    table = out / f"{command}.csv"
    out.mkdir()
    table.write_text("t,r\n0,1\n")
    refused = call(*words)
    assert refused.returncode == 2
    assert f"{table}: exists already" in refused.stderr
    assert "--force" in refused.stderr
    assert table.read_text() == "t,r\n0,1\n"
    assert not (out / f"{command}.npz").exists()
    assert call(*words, "--force").returncode in (0, 1)
    written = table.read_text()
    assert call(*words).returncode in (0, 1)
    assert table.read_text() == written
    table.write_text(written.replace("\n", "\n#\n", 1))
    assert call(*words).returncode == 2
