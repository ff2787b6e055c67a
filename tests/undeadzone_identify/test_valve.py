"""Why a control loop swings: a valve that sticks or plays, its tuning, something outside."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks.identify.logs.names import make as draw_log
from benchmarks.identify.logs.valves import ACCOUNTS, ValveLoop, make
from scipy.signal import freqz, lfilter

import undeadzone as uz
from commands import undeadzone
from further import further
from records import holds, write_log
from undeadzone.nonlinearities.play import levels
from undeadzone_identify.models.valve import (
    CHUNK,
    HE,
    KANO,
    LoopFits,
    LoopLog,
    combine_sizes,
    find_line,
    oscillation_of,
    valve_positions,
)
from undeadzone_identify.page import build_identified_page
from undeadzone_identify.selection.loop import ellipse_width

SIZE = 800


def write(loop: ValveLoop, path: Path) -> Path:
    """The log of a loop as a process historian exports it."""
    write_log(path, "time,OP,PV,SP", 1.0, loop.op, loop.pv, loop.sp)
    return path


def walk(size: int = 400) -> np.ndarray:
    """An output that turns often."""
    return np.cumsum(np.random.default_rng(3).standard_normal(size))


@pytest.mark.parametrize("account", [KANO, HE])
def test_without_a_jump_a_valve_is_a_play(account: str) -> None:
    u = walk()
    v = valve_positions(u, np.array([[2.0, 0.0]]), account)[0, :, :1]
    gap = np.array([1.0])
    assert v == pytest.approx(levels(u[:, None], gap, gap, u[:1]))


@pytest.mark.parametrize("account", [KANO, HE])
def test_many_valves_move_as_each_does_alone(account: str) -> None:
    u, stick, jump = walk(), np.array([1.0, 3.0, 4.0]), np.array([0.5, 3.0, 1.0])
    together = valve_positions(u, np.column_stack([stick, jump]), account)
    for k in range(3):
        valve = ACCOUNTS[account](float(stick[k]), float(jump[k]), float(u[0]))
        assert together[k, :, 0] == pytest.approx([valve(float(one)) for one in u])


def test_a_sine_is_regular_and_noise_is_not() -> None:
    rng = np.random.default_rng(0)
    sine = np.sin(2 * np.pi * np.arange(1000) / 40) + 0.1 * rng.standard_normal(1000)
    regular, period = oscillation_of(sine)
    assert regular > 1
    assert period == pytest.approx(40, rel=0.05)
    assert oscillation_of(rng.standard_normal(1000))[0] < 1
    assert find_line(sine) == pytest.approx((1 / 1.02, 1 / 40), rel=0.01)


def test_a_valve_that_does_not_follow_widens_the_ellipse() -> None:
    u = walk()
    ok, noise = np.isfinite(u), np.random.default_rng(1).standard_normal(u.size)
    follows, stuck = (LoopLog(u, y, ok, u) for y in (2 * u, noise))
    assert ellipse_width(follows) < 1e-6 < 0.4 < ellipse_width(stuck)


def test_a_missing_reading_is_left_out_of_the_regression() -> None:
    loop = make(1, "stiction", SIZE)
    ok = np.random.default_rng(0).uniform(size=SIZE) > 0.02
    pv = np.where(ok, loop.pv, 1e6)  # never looked at
    fits = LoopLog(loop.op, pv, ok, loop.sp).fit_all()
    assert not set(fits.regression.rows) & set(np.flatnonzero(~ok))
    assert fits.bic["stiction"] < fits.bic["none"]
    stick = combine_sizes([fits.weigh_sizes()], 0.3)[0].scale_by(float(np.ptp(loop.op)))
    assert holds(stick, loop.stick)


@pytest.mark.parametrize("stride", [1, 3])
@pytest.mark.parametrize("missing", [0.0, 0.02])
def test_many_positions_are_regressed_as_each_is_alone(stride: int, missing: float) -> None:
    """By normal equations in chunks as by orthogonal factors, also of every third sample."""
    loop = make(1, "stiction", SIZE)
    ok = np.random.default_rng(0).uniform(size=SIZE) >= missing
    log = LoopLog(loop.op, loop.pv, ok, loop.sp)
    widths = np.geomspace(0.02, 0.4, 2 * CHUNK + 1)
    positions = valve_positions(log.u, np.outer(widths, [1.0, 0.4]), KANO)
    regression, lags = log.regress(3, 40, stride), range(2, 7)
    squares = regression.regress_on_each(positions, lags)[-1]
    errors = regression.prediction_errors_of_each(positions, lags)
    assert np.allclose(squares, np.mean(errors**2, axis=1), rtol=1e-9)
    none = np.empty((SIZE, 0))
    alone = [regression.mean_square_beside(v, lags, none) for v in positions]
    assert squares == pytest.approx(alone, rel=1e-6)
    assert list(regression.rows) == list(log.regress(3, 40).rows[::stride])


SEEDS = {"stiction": 1, "dead band": 7, "tight tuning": 3, "external": 4}
WORDS = {"tight tuning": "tight_tuning", "external": "external"}


@pytest.fixture(
    scope="module", params=["stiction", "external", *further("dead band", "tight tuning")]
)
def named(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[ValveLoop, Any]:
    """A loop, and what a naive `identify` of its file says."""
    loop = make(SEEDS[request.param], request.param, SIZE)
    return loop, uz.identify(write(loop, tmp_path_factory.mktemp("loop") / "loop.csv"))


def test_a_loop_is_named_by_its_cause(named: tuple[ValveLoop, Any]) -> None:
    loop, found = named
    numbers = found.numbers()
    if loop.stick:
        assert found.verdict in ("stiction", "input_play")
        assert holds(found.width, loop.stick)
        assert numbers["loop"]["S"] == list(found.width)
    else:
        assert found.verdict == WORDS[loop.cause]
        assert found.width is None
    assert sum(numbers["odds"].values()) == pytest.approx(1)


def test_its_words_say_what_to_do(named: tuple[ValveLoop, Any]) -> None:
    found = named[1]
    remedy, number = {
        "stiction": ("see to packing, positioner", "J"),
        "input_play": ("add the gap after each reversal", "gap"),
        "tight_tuning": ("divide the gain", "divide by"),
        "external": ("look for another loop of this period upstream", "period"),
    }[found.verdict]
    assert remedy in found.summary()["remedy"][0]
    assert f"{number} " in found.headline()
    page = build_identified_page(found, {}, "loop.csv")
    assert remedy in page


@pytest.mark.parametrize(
    ("names", "word"), [("t,u,y", "operating_point"), *further(("t,OP,PV", "none"))]
)
def test_at_an_operating_point_a_loop_has_no_zone_and_a_valve_that_follows(
    names: str, word: str, tmp_path: Path
) -> None:
    """Of a process its valve is asked for, of any other loop its sensor."""
    log = draw_log(9302, "operating point")
    last = slice(-6000, None)
    rows = np.column_stack([log.step * np.arange(log.y.size), log.u, log.y])[last]
    path = tmp_path / "loop.csv"
    np.savetxt(path, rows, delimiter=",", header=names, comments="")
    found = uz.identify(path)
    assert found.verdict == word
    about = any("operating point" in one for one in found.answer.reasons)
    assert about == (word == "operating_point")


@pytest.mark.parametrize(("less", "cost"), [(0.0, "% of mean PV)"), (50.0, "(PV is about 0)")])
def test_a_valve_that_sticks_has_no_scenario(less: float, cost: str, tmp_path: Path) -> None:
    """Nor has its swing a share of a set point that PV never meets."""
    loop = make(1, "stiction", SIZE)
    write(loop._replace(pv=loop.pv - less, sp=5 * loop.sp), tmp_path / "loop.csv")
    done = undeadzone("identify", "loop.csv", "--no-figures", "--out", "o", cwd=tmp_path)
    assert done.returncode == 0
    assert "The valve sticks: S " in done.stdout
    assert cost in done.stdout
    assert "PV stays on one side of SP" in done.stdout
    assert not (tmp_path / "o" / "loop.toml").exists()


def test_the_sensitivity_of_a_loop_is_that_of_its_controller_and_plant() -> None:
    """A PI controller with a filter, behind which the plant is a gain of -0.4."""
    numerator, filtered, draw = np.array([0.7, -0.5, 0.1]), 0.3, np.random.default_rng(5)
    e = draw.normal(size=300)
    u = lfilter(numerator, np.convolve([1.0, -1.0], [1.0, -filtered]), e)
    loop: Any = SimpleNamespace(
        log=SimpleNamespace(period=20.0, error=e, u=u, ideal=None),
        regression=SimpleNamespace(responses=lambda v, lags, at, others: [-0.4] * len(at)),
        lags=range(1),
        oscillation=None,
    )
    at = 2 * np.pi / 20.0 * np.linspace(0.85, 1.15, 13)
    controller = freqz(numerator, np.convolve([1.0, -1.0], [1.0, -filtered]), at)[1]
    expected = (1 / np.abs(1 + 0.4 * controller)).max()
    assert LoopFits.sensitivity(loop) == pytest.approx(expected, rel=1e-6)
