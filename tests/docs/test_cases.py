"""The cases of the gallery: their page has the table of RESULTS.md, and the quick ones run."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from benchmarks.end_to_end import cases
from benchmarks.end_to_end.machines import BAND, CASES, DEAD_BAND, GAP, LOST, STAR, ZONE
from benchmarks.markdown import parted

from documents import ROOT
from requirements import require

TRUE = {
    "load_cell": ZONE,
    "speed_controller": BAND,
    "hobby_servo": (LOST,),
    "two_encoders": (GAP,),
    "mount": (STAR,),
    "valve": (DEAD_BAND,),
}
QUICK = ("hobby_servo", "two_encoders", "mount")


def rows() -> list[str]:
    """Return the lines of the table in RESULTS.md."""
    results = parted((ROOT / "benchmarks/RESULTS.md").read_text(encoding="utf-8"))["## Cases"]
    return [line for line in results.split("\n") if line.startswith("|")]


def table(page: str) -> list[str]:
    """Return the lines of the table of the cases on a page of docs."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return text.partition("<!-- cases -->\n")[2].partition("\n<!-- /cases -->")[0].split("\n")


def test_the_pages_have_the_table_of_the_results() -> None:
    assert table("cases.md") == rows()
    columns = [line.split(" | ") for line in rows()[2:]]
    home = table("index.md")[2:]
    assert {*home} <= {f"{name} | {interval} | {error}" for name, _, interval, _, error in columns}
    assert len(home) >= 10
    assert set(TRUE) == set(CASES)


@pytest.mark.parametrize("log", [*(ROOT / "docs/trades").glob("*.csv")], ids=lambda log: log.stem)
def test_a_log_to_download_is_that_of_its_case(log: Path) -> None:
    recorded = CASES[log.stem].record(np.random.default_rng(cases.SEED))
    np.testing.assert_allclose(np.loadtxt(log, delimiter=",", skiprows=1), recorded, rtol=1e-5)


@pytest.mark.parametrize("name", CASES)
def test_the_bench_measures_what_the_machine_has(name: str) -> None:
    benches = [CASES[name].measure(np.random.default_rng(seed)) for seed in range(20)]
    for k, true in enumerate(TRUE[name]):
        covered = [abs(one[k].value - true) <= 1.5 * one[k].error for one in benches]
        assert np.mean(covered) >= 0.8
        assert np.mean([one[k].value for one in benches]) == pytest.approx(true, rel=0.08)


@pytest.mark.parametrize("name", QUICK)
def test_a_case_runs_from_its_log_to_compiled_c(name: str, tmp_path: Path) -> None:
    from shutil import which

    require("compiler", [] if which("gcc") else ["gcc"])
    case = CASES[name]
    outcome = cases.run_case(name, case, tmp_path)
    for (_, low, high), true in zip(outcome.found, TRUE[name], strict=True):
        assert low < true < high
    without, with_it = outcome.errors
    assert with_it < 0.1 * without
    (table_row,) = (line for line in rows() if line.startswith(f"| {case.title} |"))
    row = cases._row_of(case.title, outcome, case.unit, case.error_unit)
    numbers = [float(word) for word in re.findall(r"[\d.]+(?:e-?\d+)?", row)]
    assert [float(word) for word in re.findall(r"[\d.]+(?:e-?\d+)?", table_row)] == pytest.approx(
        numbers, rel=0.02
    )


def test_the_public_record_is_read_and_its_zone_imposed(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    given = rng.standard_normal((1024, 2))
    np.savetxt(tmp_path / "robot_arm.dat", given)
    case = cases.daisy_case(tmp_path / "robot_arm.dat")
    log, widths = case.record(rng), case.measure(rng)
    z = given[:, 1] - given[:, 1].mean()
    inside = (z < widths[0].value) & (z > -widths[1].value)
    assert widths[0].value == pytest.approx(0.5 * z.std())
    assert np.array_equal(log[:, 2] == 0.0, inside)
    assert case.use(rng, float) > case.use(rng, lambda y: y + widths[0].value * np.sign(y))


def test_the_widths_of_the_arms_are_those_of_their_examples() -> None:
    text = (ROOT / "examples/two_link_gears.toml").read_text(encoding="utf-8")
    assert cases._read_true_widths(text) == pytest.approx([0.1, 0.12])
    text = (ROOT / "examples/ur5.toml").read_text(encoding="utf-8")
    assert cases._read_true_widths(text)[0] == pytest.approx(0.08)
