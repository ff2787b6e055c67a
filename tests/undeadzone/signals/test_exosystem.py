"""Signals: values, derivatives against finite differences, the exosystem w' = S w, CSV files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from scenes import seeds
from undeadzone.errors import FileError
from undeadzone.signals import exosystem as signals
from undeadzone.signals.exosystem import (
    Exosystem,
    Random,
    Samples,
    Signal,
    Sine,
    Sines,
    Step,
    Tone,
    Trapezoid,
    build_exosystem,
    common_period,
    read_csv,
)
from undeadzone.util.arrays import Floats

T = np.linspace(0.013, 5.987, 523)


def write_csv(path: Path, rows: Any, header: str = "") -> str:
    path.write_text(
        header + "\n".join(",".join(map(str, row)) for row in rows) + "\n", encoding="utf-8"
    )
    return str(path)


@pytest.fixture
def smooth(tmp_path: Path) -> Samples:
    t = np.linspace(0.5, 5.5, 41)
    return Samples(path=write_csv(tmp_path / "smooth.csv", np.stack([t, np.sin(t), t**2], axis=1)))


@pytest.fixture
def lines(tmp_path: Path) -> Samples:
    return Samples(
        path=write_csv(tmp_path / "lines.csv", [(1, 0, 0), (2, 1, -1), (4, 1, 3)]), smooth=False
    )


def two_channels(smooth: Samples, lines: Samples) -> list[tuple[Signal, list[float]]]:
    """Signals of two channels with the times of their corners."""
    return [
        (Sine(amplitude=[5.0, 2.0], frequency=1.3, phase=[0.0, 0.7], offset=[0.0, 1.0]), []),
        (
            Sines(
                components=[
                    Tone(amplitude=1.0, frequency=0.5),
                    Tone(amplitude=[0.0, 3.0], frequency=2.0),
                ],
                offset=0.5,
            ),
            [],
        ),
        (Step(amplitude=[1.0, 2.0], time=2.0, before=-1.0), [2.0]),
        (
            Trapezoid(amplitude=[1.0, 2.0], rise=0.7, hold=0.4),
            list(np.cumsum([0.7, 0.4, 1.4, 0.4, 0.7] * 2)),
        ),
        (smooth, [0.5, 5.5, *np.linspace(0.5, 5.5, 41)]),
        (lines, [1.0, 2.0, 4.0]),
    ]


def slopes_agree(
    path: Exosystem, t: Floats, highest: int, corners: Any, tolerance: float = 1e-6
) -> None:
    """Derivatives are those of the values at the instants that are no corners."""
    h = 1e-5
    t = t[np.abs(t[:, None] - np.array([*corners, -100.0])).min(axis=1) > 2 * h]
    assert t.size > 200
    for order in range(highest):
        slope = (path.output_at(t + h, order) - path.output_at(t - h, order)) / (2 * h)
        assert path.output_at(t, order + 1) == pytest.approx(
            slope, abs=tolerance * (1 + np.abs(slope).max())
        )


def state_obeys(found: Exosystem, t: Floats, h: float, corners: Any) -> None:
    """w' = S w at the instants from which no corner comes within h [s]."""
    t = t[[not any(at <= corner <= at + h for corner in corners) for at in t]]
    ahead = found.state(t) @ expm(found.S * h).T
    assert found.state(t + h) == pytest.approx(ahead, abs=1e-9 * (1 + np.abs(ahead).max()))
    assert found.output_at(t) == pytest.approx(found.state(t) @ found.Q.T)


def test_derivatives_and_exosystem_are_those_of_the_values(smooth: Samples, lines: Samples) -> None:
    for signal, corners in two_channels(smooth, lines):
        found = build_exosystem("reference", signal, 2)
        slopes_agree(found, T, 3, corners, 1e-4)
        state_obeys(found, T, 1e-3, corners)
        assert found.output_at(T).shape == (T.size, 2)


def one(signal: Signal) -> Any:
    return lambda *t: build_exosystem("reference", signal, 1).output_at(np.array(t, float)).ravel()


def test_values_in_closed_form() -> None:
    assert one(Sine(amplitude=5.0, frequency=1.0))(0.0, 0.25, 0.5, 0.75) == pytest.approx(
        [0, 5, 0, -5]
    )
    assert one(Sine(amplitude=5.0, frequency=1.0, phase=np.pi / 2, offset=1.0))(
        0.0
    ) == pytest.approx(6)
    both = Sines(
        components=[
            Tone(amplitude=1.0, frequency=0.5),
            Tone(amplitude=2.0, frequency=1.0, phase=0.3),
        ],
        offset=-1.0,
    )
    assert one(both)(0.2) == pytest.approx(
        np.sin(np.pi * 0.2) + 2 * np.sin(2 * np.pi * 0.2 + 0.3) - 1
    )
    assert one(Step(amplitude=2.0, time=1.0, before=-1.0))(0.0, 0.999, 1.0, 5.0).tolist() == [
        -1,
        -1,
        2,
        2,
    ]
    trapezoid = one(Trapezoid(amplitude=3.0, rise=1.0, hold=2.0))
    assert trapezoid(0.0, 0.5, 1.0, 2.9, 4.0, 5.0, 6.9, 7.5, 8.0, 8.5) == pytest.approx(
        [0, 1.5, 3, 3, 0, -3, -3, -1.5, 0, 1.5]
    )
    assert one(Trapezoid(amplitude=1.0, rise=1.0, hold=0.0))(1.0, 2.0, 3.0, 4.0) == pytest.approx(
        [1, 0, -1, 0], abs=1e-12
    )


@given(seeds, st.integers(3, 12))
def test_csv_goes_through_its_samples_and_is_constant_beyond_its_ends(
    tmp_path_factory: pytest.TempPathFactory, seed: int, count: int
) -> None:
    rng = np.random.default_rng(seed)
    t, values = np.cumsum(rng.uniform(0.1, 1.0, count)), rng.normal(size=count)
    path = write_csv(tmp_path_factory.mktemp("csv") / "samples.csv", np.stack([t, values], axis=1))
    for smooth in (True, False):
        value = one(Samples(path=path, smooth=smooth))
        assert value(*t) == pytest.approx(values, abs=1e-9)
        assert value(t[0] - 1, t[-1] + 1) == pytest.approx(values[[0, -1]], abs=1e-9)
    middle = (t[:-1] + t[1:]) / 2
    assert value(*middle) == pytest.approx((values[:-1] + values[1:]) / 2, abs=1e-9)


def test_smooth_samples_follow_a_sine_closely(smooth: Samples) -> None:
    t = np.linspace(0.5, 5.5, 1001)
    found = build_exosystem("reference", smooth, 2)
    assert np.abs(found.output_at(t)[:, 0] - np.sin(t)).max() < 1e-5
    assert np.abs(found.output_at(t, 1)[:, 1] - 2 * t).max() < 1e-9


@pytest.mark.parametrize(
    "start",
    ["", "time,angle\n", "# made by hand\nt [s],z [rad]\n", "\ufeff", "\ufefftime,angle\n", "\n"],
)
def test_csv_header_comments_and_byte_order_mark(tmp_path: Path, start: str) -> None:
    path = write_csv(tmp_path / "r.csv", [(0, 1), (1, 3), (2, 5)], start)
    t, values = read_csv("reference", path, 1)
    assert (t.tolist(), values.tolist()) == ([0, 1, 2], [[1], [3], [5]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "holds no samples"),
        ("time,z\n", "holds no samples"),
        ("0,1\n1,2,3\n", "sample 2 has 3 columns, expected 2"),
        ("0,1\n1\n", "sample 2 has 1 column, expected 2"),
        ("0,1\n1,two\n", "sample 2 is not all finite numbers: see column 2"),
        ("0,1\n1,\n", "sample 2 is not all finite numbers"),
        ("0.0x,1\n1,2\n2,3\n", "sample 1 is not all finite numbers"),
        ("0,nan\n1,2\n2,3\n", "sample 1 is not all finite numbers"),
        ("0,1\n1,inf\n", "sample 2 is not all finite numbers"),
        ("0,1\n", "two samples or more"),
        ("0,1\n0,2\n", "time increasing"),
        ("1,1\n0,2\n", "time increasing"),
        ("0;1\n1;2\n", "sample 1 has 1 column, expected 2 .*commas"),
    ],
)
def test_wrong_csv(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(FileError, match=f"^reference.path: .*bad.csv.*{words}"):
        build_exosystem("reference", Samples(path=str(tmp_path / "bad.csv")), 1)


def test_unreadable_csv(tmp_path: Path) -> None:
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x01")
    for path, words in [
        ("missing.csv", "No such file"),
        (".", "directory"),
        ("binary.csv", "UTF-8"),
        ("nul\0.csv", "null"),
    ]:
        with pytest.raises(FileError, match=f"reference.path: .*cannot read: .*{words}"):
            build_exosystem("reference", Samples(path=f"{tmp_path}/{path}"), 1)


def test_random_is_a_disturbance_only() -> None:
    assert not isinstance(Random(rms=1.0, correlation_time=1.0), signals.Signal)
    assert isinstance(Sine(amplitude=1.0, frequency=1.0), signals.Signal)


@pytest.mark.parametrize(
    ("frequencies", "period"),
    [([2.0], 0.5), ([1.0, 1.5], 2.0), ([0.3, 0.5, 0.7], 10.0), ([1.0, np.sqrt(2)], None)],
)
def test_common_period(frequencies: list[float], period: float | None) -> None:
    if period is None:
        assert common_period(frequencies) is None
    else:
        assert common_period(frequencies) == pytest.approx(period, rel=1e-12)


@pytest.mark.parametrize("shape", [signals.line_derivatives, signals.spline_derivatives])
def test_shapes_go_through_their_samples_and_are_constant_beyond_their_ends(shape: Any) -> None:
    t = np.array([0.0, 0.5, 2.0, 3.0])
    values = np.array([[1.0, 0.0], [2.0, -1.0], [0.0, 4.0], [3.0, 3.0]])
    derivatives = shape(t, values)
    assert derivatives(t)[:, 0] == pytest.approx(values)
    outside = derivatives(np.array([-1.0, 9.0]))
    assert outside[:, 0] == pytest.approx(values[[0, -1]])
    assert not outside[:, 1:].any()


def test_a_trapezoid_by_hand() -> None:
    corners = np.array([0.0, 1.0, 3.0, 5.0, 7.0, 8.0])
    derivatives = signals.trapezoid_derivatives(corners, np.array([2.0]))
    values = derivatives(np.array([0.5, 2.0, 4.5, 6.0, 7.5, 8.5]))[:, :, 0]
    assert values[:, 0].tolist() == [1.0, 2.0, -1.0, -2.0, -1.0, 1.0]
    assert values[:, 1].tolist() == [2.0, 0.0, -2.0, 0.0, 2.0, 2.0]
