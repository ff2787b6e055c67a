"""`--to python`: a module that runs without undeadzone and gives the numbers of Online."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

import undeadzone as uz
from documents import ROOT
from undeadzone_export import exporting

DRIVE = """
import json, sys
sys.path.insert(0, ".")
import arm_joint

one, two = arm_joint.Instance(), arm_joint.Instance()
rows = []
for y, u in json.load(sys.stdin):
    rows.append(one.update(float("nan") if y is None else y, u)._asdict())
    two.inputs.y[0], two.inputs.u[0] = -1.0, 0.0
    two.step()
assert two.out.x[0] != one.out.x[0]
assert "undeadzone" not in sys.modules and "numpy" not in sys.modules
one.reset()
first = one.update([-1.0], (0.0,))


class Scalar:  # as an array of no axes
    shape = ()

    def __len__(self):
        raise TypeError("len() of unsized object")

    def __float__(self):
        return -1.0


one.reset()
assert one.update(Scalar(), 0.0) == first
for y in (None, "far", [1.0, 2.0]):
    try:
        one.update(y, 0.0)
    except ValueError as error:
        rows.append(str(error))
print(json.dumps([rows, one.params.observer_gamma[0], arm_joint.STEP, first.x]))
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(exporting, "STEPS", 600)
    done = uz.export(
        uz.read(ROOT / "examples" / "firmware.toml"),
        to="python",
        out=tmp_path / "joint",
        tunable=("observer.gamma",),
        check=True,
    )
    assert done.has_passed
    assert "every bit agrees" in done.report["self_test"]
    return tmp_path / "joint"


def run(code: str, folder: Path, given: str = "", **environment: str) -> tuple[int, str, str]:
    """Exit code and output of Python without packages."""
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", code],
        cwd=folder,
        input=given,
        capture_output=True,
        text=True,
        env=os.environ | environment,
    )
    return done.returncode, done.stdout, done.stderr


def test_the_module_gives_the_numbers_of_online(folder: Path) -> None:
    of = uz.read(ROOT / "examples" / "firmware.toml")
    online = uz.Online(of.observer, of.plant, of.sensor, of.simulation.step)
    samples = [(2 * np.sin(0.1 * k) if k % 9 else None, np.cos(k)) for k in range(200)]
    code, out, problems = run(DRIVE, folder, json.dumps(samples))
    assert code == 0, problems
    rows, gamma, step, first = json.loads(out)
    assert rows.pop() == "y: expected 1 numbers, found 2"
    assert rows.pop() == "y: expected 1 numbers, found 3"
    assert rows.pop() == "y: expected numbers, found None; nan stands for a missing one"
    assert (gamma, step) == (0.01, 1e-3)
    for (y, u), row in zip(samples, rows, strict=True):
        estimate = online.update(np.nan if y is None else y, u)
        for name in ("x", "z", "right", "left", "z_inverse", "innovation"):
            assert row[name] == getattr(estimate, name).tolist()
        assert row["side"] == online.side.tolist()
    fresh = uz.Online(of.observer, of.plant, of.sensor, of.simulation.step)
    assert first == fresh.update(-1.0, 0.0).x.tolist()


def test_the_example_of_the_page_and_a_missing_compiler(folder: Path) -> None:
    page = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
    example = re.findall(r"```py\n(.*?)```", page, re.S)[0]
    here = "import sys; sys.path.insert(0, '.')\n"
    code, _, problems = run(here + example, folder, PATH=str(folder), CC="")
    assert code == 1
    assert "no C compiler: expected cc, gcc or clang" in problems
    assert not list(folder.glob("*.so"))
    code, out, problems = run(here + example, folder)
    assert (code, problems, out) == (0, "", "(0.0,) (0.2,)\n")
    assert len(list(folder.glob("*.so"))) == 1


def test_nothing_of_a_title_or_unit_ends_the_docstring(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exporting, "STEPS", 600)
    of = uz.read(ROOT / "examples" / "firmware.toml")
    nasty = 'x"""\nimport os\\N{nothing} \\'
    units = msgspec.structs.replace(of.units, output=nasty)
    changed = msgspec.structs.replace(of, title=nasty, units=units)
    uz.export(changed, to="python", out=tmp_path / "joint", name="joint")
    text = (tmp_path / "joint" / "joint.py").read_text(encoding="utf-8")
    assert compile(text, "joint.py", "exec")
    assert "\nimport os\\N" not in text


RESUME = """
import sys
sys.path.insert(0, ".")
import arm_joint

whole, first, second = arm_joint.Instance(), arm_joint.Instance(), arm_joint.Instance()
for k in range(400):
    y, u = 3.0 * (k % 7) - 9.0, 1.0 - k % 3
    out = whole.update(y, u)
    if k == 200:
        second.restore(first.memory())
    half = (first if k < 200 else second).update(y, u)
    assert half == out, k
for wrong in (first.memory()[:-1], b"x" + first.memory()[1:]):
    try:
        second.restore(wrong)
    except ValueError as error:
        print(error)
"""


def test_memory_goes_on_in_another_instance(folder: Path) -> None:
    code, out, err = run(RESUME, folder)
    assert code == 0, err
    assert out == "these bytes are no memory of this export\n" * 2
