"""What is installed from a wheel is whole: commands run outside of the checkout."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
QUIET = ["--quiet", "--disable-pip-version-check", "--no-index", "--no-deps"]


def run(*words: str | Path, cwd: Path) -> str:
    """What a command prints. It must not fail, and sees no checkout."""
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(cwd), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [str(word) for word in words],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:] + done.stdout[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this checkout, built elsewhere."""
    pytest.importorskip("setuptools", "77")
    source = tmp_path_factory.mktemp("source") / "undeadzone"
    shutil.copytree(ROOT / "src", source / "src", ignore=shutil.ignore_patterns("*.egg-info"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    out = source.parent / "wheels"
    build = ["wheel", *QUIET, "--no-build-isolation", "--wheel-dir", out, "."]
    run(sys.executable, "-m", "pip", *build, cwd=source)
    (path,) = out.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with the wheel; its dependencies are those of this one."""
    folder = tmp_path_factory.mktemp("environment") / "venv"
    run(sys.executable, "-m", "venv", "--without-pip", folder, cwd=folder.parent)
    python = folder / "bin" / "python"
    install = ["--python", python, "install", *QUIET, "--no-warn-script-location", wheel]
    run(sys.executable, "-m", "pip", *install, cwd=folder.parent)
    (packages,) = folder.glob("lib/python*/site-packages")
    (packages / "others.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    return folder / "bin"


def test_the_wheel_holds_every_file_of_the_package(wheel: Path) -> None:
    held = set(zipfile.ZipFile(wheel).namelist())
    for path in (ROOT / "src" / "undeadzone").rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts:
            assert str(path.relative_to(ROOT / "src")) in held


def test_commands_run_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    command = installed / "undeadzone"
    place = "import undeadzone as uz; print(uz.__file__, [getattr(uz, n) for n in uz.__all__])"
    assert str(installed.parent) in run(installed / "python", "-c", place, cwd=tmp_path)
    run(command, "init", "mine.toml", cwd=tmp_path)
    told = run(command, "run", "mine.toml", "--json", "--out", "out", cwd=tmp_path)
    assert json.loads(told)["diverged_at"] is None
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000
    arena = ["arena", "mine.toml", "--methods", "certified", "--seeds", "1", "--processes", "1"]
    assert "full_state" in run(command, *arena, cwd=tmp_path)
