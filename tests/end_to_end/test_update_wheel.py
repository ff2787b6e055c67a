"""The distribution `deadzone_update` needs NumPy alone, and computes what the tool computes."""

from __future__ import annotations

import io
import re
import subprocess
import sys
import zipfile
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import once
from packed import QUIET, ROOT, copied, run
from packed import wheel as built
from requirements import import_package, needs

README = (ROOT / "packages/deadzone_update/README.md").read_text(encoding="utf-8")
PYTHON, C = (re.findall(rf"```{kind}\n(.*?)```", README, re.S)[0] for kind in ("python", "c"))
# All that the program sees besides the standard library: `-S` hides what is installed here.
ALONE = "import sys; sys.path[:0] = sys.argv[1:]; exec(sys.stdin.read())"
BITS = "\nprint(mean.tobytes().hex(), cov.tobytes().hex())\n"
ABSENT = """
from importlib.util import find_spec
assert not (find_spec("casadi") or find_spec("undeadzone"))
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    import_package("hatchling")
    return built(copied(tmp_path_factory.mktemp("wheels")) / "packages" / "deadzone_update")


@pytest.fixture(scope="module")
def example() -> dict[str, Any]:
    """Names of README's program after it ran here, with the tool's update."""
    names: dict[str, Any] = {}
    code = PYTHON.replace("from deadzone_update", "from undeadzone")
    with redirect_stdout(io.StringIO()) as printed:
        exec(code + BITS, names)
    return names | {"printed": printed.getvalue()}


def test_the_program_of_its_page_gives_the_bits_of_the_tool(
    wheel: Path, example: dict[str, Any], tmp_path: Path
) -> None:
    target, arrays = tmp_path / "target", tmp_path / "numpy alone"
    install = ["install", *QUIET, "--target", target, wheel]
    run(sys.executable, "-m", "pip", *install, cwd=tmp_path)
    arrays.mkdir()
    for path in Path(np.__file__).parents[1].glob("numpy*"):
        (arrays / path.name).symlink_to(path)
    done = subprocess.run(
        [sys.executable, "-S", "-W", "error", "-c", ALONE, target, arrays],
        input=PYTHON + ABSENT + BITS,
        env={"OMP_NUM_THREADS": "1"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == example["printed"]


@needs("compiler", "gcc")
def test_the_c_of_its_page_computes_the_same(
    wheel: Path, example: dict[str, Any], tmp_path: Path
) -> None:
    with zipfile.ZipFile(wheel) as archive:
        header = archive.read("deadzone_update/deadzone_update.h")
    (tmp_path / "deadzone_update.h").write_bytes(header)
    (tmp_path / "main.c").write_text(C)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1"]
    program = once.program(["filter", *flags, "main.c"], tmp_path)
    log = "\n".join(f"{y!r} {u!r}" for y, u in np.array(example["log"]).tolist())
    printed = subprocess.run([program], input=log, capture_output=True, text=True, check=True)
    x, variances = np.array(printed.stdout.split(), float).reshape(4, 2).T
    assert x == pytest.approx(example["mean"], rel=1e-9, abs=1e-9)
    assert variances == pytest.approx(np.diag(example["cov"]), rel=1e-6)


def test_its_files_are_those_of_the_tool(wheel: Path) -> None:
    """Nothing in it has a second definition, but for the file of names."""
    sources = {path.read_bytes() for path in (ROOT / "src/undeadzone").rglob("*.*")}
    with zipfile.ZipFile(wheel) as archive:
        members = [name for name in archive.namelist() if name.startswith("deadzone_update/")]
        own = {name for name in members if archive.read(name) not in sources}
    assert own == {"deadzone_update/__init__.py", "deadzone_update/LICENSE"}
