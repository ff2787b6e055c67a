"""The wheel of this checkout in an environment of its own, which sees no checkout.

`python tests/packed.py` runs the tests there; its arguments go to pytest.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import click

ROOT = Path(__file__).parents[1]
SOURCES = ("pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE", "CITATION.cff")
QUIET = ["--quiet", "--disable-pip-version-check", "--no-index", "--no-deps"]


def run(*words: str | Path, cwd: Path, **variables: str) -> str:
    """What a command prints. It must not fail, and sees no checkout, but variables."""
    around = {"PATH": "/usr/bin:/bin", "HOME": str(cwd), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [str(word) for word in words],
        cwd=cwd,
        env=around | variables,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:] + done.stdout[-2000:]
    return done.stdout


def copied(folder: Path) -> Path:
    """A copy, in a folder, of what a wheel is made of."""
    source = folder / "undeadzone"
    unwanted = shutil.ignore_patterns("__pycache__", "*.egg-info")
    for name in ("src", "examples", "packages"):
        shutil.copytree(ROOT / name, source / name, ignore=unwanted)
    for name in SOURCES:
        shutil.copy(ROOT / name, source / name)
    return source


def wheel(source: Path, **variables: str) -> Path:
    """The wheel of a copy, built beside it."""
    build = ["wheel", *QUIET, "--no-build-isolation", "--wheel-dir", source.parent, "."]
    run(sys.executable, "-m", "pip", *build, cwd=source, **variables)
    (path,) = source.parent.glob("*.whl")
    return path


def install(packed: Path, programs: Path) -> None:
    """Install a wheel into the environment that has these programs, without its dependencies."""
    options = ["--python", programs / "python", "install", *QUIET, "--no-warn-script-location"]
    run(sys.executable, "-m", "pip", *options, packed, cwd=programs)


def environment(packed: Path, folder: Path) -> Path:
    """The programs of an environment in a folder, with a wheel.

    Its dependencies are those of this environment, so that nothing is fetched.
    """
    run(sys.executable, "-m", "venv", "--without-pip", folder, cwd=folder.parent)
    install(packed, folder / "bin")
    (packages,) = folder.glob("lib/python*/site-packages")
    others = folder / "others"
    others.mkdir()
    for path in Path(click.__file__).parents[1].iterdir():
        if "undeadzone" not in path.name:
            (others / path.name).symlink_to(path)
    (packages / "others.pth").write_text(f"{others}\n")
    return folder / "bin"


def main() -> int:
    """Run pytest on this checkout's tests with the wheels in place of src."""
    with tempfile.TemporaryDirectory() as folder:
        source = copied(Path(folder))
        programs = environment(wheel(source), Path(folder) / "venv")
        install(wheel(source / "packages" / "undeadzone_arena"), programs)
        others = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        where = [programs / "python", "-c", "import undeadzone; print(undeadzone.__file__)"]
        print("testing", run(*where, cwd=Path(folder)), end="", flush=True)  # noqa: T201
        tests = [str(programs / "python"), "-m", "pytest", *sys.argv[1:]]
        return subprocess.run(tests, cwd=ROOT, env=others, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
