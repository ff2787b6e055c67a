"""The pages of the export, docs/export*.md, show what it writes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import undeadzone as uz
from documents import ROOT
from undeadzone_export import exporting

PAGE = "".join(page.read_text("utf-8") for page in sorted((ROOT / "docs").glob("export*.md")))
CODE = (ROOT / "docs" / "export_accuracy.md").read_text(encoding="utf-8")


def test_the_code_in_the_page_is_the_exported_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exporting, "STEPS", 600)
    scenario = uz.read(ROOT / "examples" / "firmware.toml")
    report = uz.export(scenario, out=tmp_path / "fw").report
    code = (tmp_path / "fw" / "arm_joint.c").read_text(encoding="utf-8")
    displayed = re.findall(r"\n```c\n(.*?)```", CODE, re.S)[-1]
    indented = "".join(f"    {line}\n" for line in displayed.splitlines())
    assert indented in code
    counts = ", ".join(f"{count} {word}" for word, count in report["operations"].items())
    assert counts in PAGE
    for word in ("state", "in", "out"):
        assert f"{word} {report['sizes'][word]}" in PAGE
    written = set(re.findall(r"`(arm_joint[\w.]*|\w+\.json|README.md|Makefile)`", PAGE))
    assert set(report["files"]) - {"CMakeLists.txt"} <= written


def test_the_page_says_how_long_structured_text_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exporting, "STEPS", 600)
    scenario = uz.read(ROOT / "examples" / "firmware.toml")
    report = uz.export(scenario, "st", tmp_path / "plc").report
    assert f"| {report['structured_text']['lines']} | `undeadzone export examples" in PAGE
    assert "after 108 cycles" in PAGE
    assert "TRUE after 108 cycles" in (tmp_path / "plc" / "arm_joint_test.st").read_text()


def test_the_page_names_every_option() -> None:
    from undeadzone_export.command import export as command

    for parameter in command.params:
        for name in parameter.opts:
            assert not name.startswith("--") or name in PAGE, name
