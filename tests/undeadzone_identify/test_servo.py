"""A servo behind gear play: its gap from a log, whatever else is there, or none."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pytest
from benchmarks.identify.logs.mujoco_servo import mujoco_log
from benchmarks.identify.logs.servo import (
    Servo,
    input_at_random,
    random_log,
    recorded,
    torque_at_random,
)
from scipy.signal import lfilter
from scipy.stats import norm

import undeadzone as uz
from further import further
from records import holds, identify_log
from requirements import needs
from undeadzone.cli import group
from undeadzone.scenario.reader import parse
from undeadzone.util.arrays import Floats
from undeadzone_export import exporting
from undeadzone_identify.logs.grid import common_spacing
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.selection import servo as selection
from undeadzone_identify.servo import predictor
from undeadzone_identify.servo.crossings import GapCrossings, find_crossings
from undeadzone_identify.servo.gap import (
    ServoGap,
    collect_odd_errors,
    covariance_of,
    identify_servo_gap,
)
from undeadzone_identify.servo.likelihood import (
    At,
    ErrorSlopes,
    ServoLikelihood,
    ServoStructure,
    discretise_servo,
)
from undeadzone_identify.servo.likelihood import Servo as Fitted
from undeadzone_identify.servo.observations import (
    CHANCE,
    Observations,
    build_observations,
    tick_loop_p_value,
)
from undeadzone_identify.servo.search import neighbour_servos

STEP, SIZE = 0.005, 1600
MOTOR = Servo(
    damping=6.0,
    gain=8.0,
    spring=0.0,
    pole=0.0,
    friction=0.12,
    gap=0.03,
    quantum=0.002,
    delay=1,
    proportional=0.0,
    rate=0.0,
)
START = np.zeros(1, int)
RESTS = {"encoder": (0.002, 0.0), "exact": (0.0, 0.0), "noise": (0.0, 0.0015)}


def logged(
    servo: Servo, seed: int = 1, noise: float = 0.0, torque: float = 0.03, closed: bool = False
) -> tuple[Floats, Floats]:
    """u and y of a servo in open or in closed loop."""
    draw = np.random.default_rng(seed)
    command = input_at_random(draw, SIZE)
    if closed:
        command = command / servo.proportional
    return recorded(
        servo,
        STEP,
        command,
        torque * draw.standard_normal(SIZE),
        noise * draw.standard_normal(SIZE),
        closed,
    )


def write_log(u: Floats, y: Floats) -> None:
    """Write the log to log.csv."""
    rows = np.column_stack([STEP * np.arange(SIZE), u, y])
    np.savetxt("log.csv", rows, delimiter=",", header="t,u,y", comments="", fmt="%.12g")


def listened(u: Floats, y: Floats, step: float = STEP) -> Observations:
    """The log as the predictor hears it."""
    found = build_observations(u, y, np.ones(y.size, bool), START, step)
    assert found is not None
    return found


def answered(u: Floats, y: Floats, step: float = STEP) -> ServoGap:
    """What the predictor says."""
    found = identify_servo_gap(listened(u, y, step))
    assert found is not None
    return found


@pytest.mark.parametrize(  # each two of reading, spring and loop meet
    ("reading", "spring", "closed"),
    [
        ("exact", 0.0, False),
        ("encoder", 40.0, False),
        ("noise", 40.0, True),
        *further(("exact", 40.0, True), ("encoder", 0.0, True), ("noise", 0.0, False)),
    ],
)
def test_the_gap_of_a_servo(reading: str, spring: float, closed: bool) -> None:
    quantum, noise = RESTS[reading]
    servo = MOTOR._replace(spring=spring, quantum=quantum)
    if closed:
        servo = servo._replace(proportional=12.0, rate=0.5)
    u, y = logged(servo, noise=noise, closed=closed)
    found = answered(u, y)
    assert found.log.ticks == (reading != "noise")
    assert not found.reasons
    assert abs(found.gap.value - 0.03) < (0.002 if reading == "noise" else 0.001)
    assert found.gap.low - 2e-4 <= 0.03 <= found.gap.high + 2e-4
    assert found.log.is_closed_loop == closed
    assert "friction" in found.servo.structure.parts or "slow" in found.servo.structure.parts


@pytest.mark.parametrize("reading", ["encoder", "noise"])
def test_friction_of_the_load_is_not_felt_in_the_gap(reading: str) -> None:
    """Taken for the motor's, it made gaps 15 % too small, and intervals a tenth of that wide."""
    quantum, noise = RESTS[reading]
    u, y = logged(MOTOR._replace(friction=0.05, load=0.15, quantum=quantum), noise=noise)
    found = answered(u, y)
    one = found.servo
    assert "load" in one.structure.parts
    assert abs(float(one.theta[At.LOAD]) * found.log.u_scale / 0.15 - 1) < 0.15
    assert not found.reasons
    assert holds(found.gap, 0.03)
    assert abs(found.gap.value / 0.03 - 1) < 0.03


def test_friction_of_the_load_goes_from_a_log_to_mujoco(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As that of the link, on a tendon over both hinges; the motor's is the motor's alone."""
    u, y = logged(MOTOR._replace(friction=0.05, load=0.15))
    monkeypatch.chdir(tmp_path)
    write_log(u, y)
    assert not group.main(["identify", "log.csv"], standalone_mode=False)
    servo = json.loads(Path("log-identify/identify.json").read_text(encoding="utf-8"))["servo"]
    assert servo["load_friction"] == pytest.approx(0.15, rel=0.15)
    root = ElementTree.parse("log-identify/gears.xml")
    motor, [link] = next(root.iter("joint")), root.iter("fixed")
    for part, name in ((motor, "friction"), (link, "load_friction")):
        assert float(part.get("frictionloss", 0)) == pytest.approx(servo[name], rel=1e-4)


def test_the_gap_of_a_joint_in_mujoco() -> None:
    """A simulator that knows nothing of the predictor's equations: a link, pushed between stops."""
    log = mujoco_log(12)
    found = answered(log.u, log.y, log.step)
    assert not found.reasons
    assert holds(found.gap, log.servo.gap)
    assert abs(found.gap.value / log.servo.gap - 1) < 0.03


@pytest.mark.parametrize("quantum", [0.0, 0.05])
def test_a_play_behind_a_plant_of_first_order_is_one(quantum: float) -> None:
    """Exact and quantised readings were denied it; noisy ones were not."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.standard_normal(100), 12)
    z = lfilter([0.0, 0.05], [1.0, -0.95], u)
    z = z / z.std()
    y, now = np.empty(z.size), 0.0
    for k, value in enumerate(z):
        now = max(min(now, value + 0.2), value - 0.3)
        y[k] = now
    y = quantum * np.round(y / quantum) if quantum else y
    found = uz.identify(t=0.05, u=u, y=y)
    assert found.verdict == "play"
    for interval, truth in ((found.width, 0.5), (found.right, 0.3), (found.centre, 0.05)):
        assert interval is not None
        assert interval.low - 1e-4 <= truth <= interval.high + 1e-4
        assert interval.half_width < 0.02
    parse(found.scenario())


@pytest.fixture(scope="module")
def with_friction() -> tuple[Observations, ServoGap]:
    """A log with much friction, and what is found."""
    u, y = logged(MOTOR._replace(friction=0.3), seed=4)
    found = answered(u, y)
    return found.log, found


def test_friction_that_is_left_out_shows_in_the_crossings(
    with_friction: tuple[Observations, ServoGap],
) -> None:
    log, found = with_friction
    assert "friction" in found.servo.structure.parts
    assert found.servo.theta[At.FRICTION] * log.u_scale == pytest.approx(0.3, rel=0.15)
    structure = found.servo.structure._replace(parts=frozenset())
    theta = structure.disable_absent_parts(found.servo.theta)
    bare = find_crossings(log, Fitted(structure, theta, 0.0))
    assert bare.gap_scatter > 2 * found.crossings.gap_scatter
    assert bare.describe_trends() or abs(bare.median_gap - 0.03) > 3 * bare.median_error


def test_a_part_that_is_added_never_costs_likelihood(
    with_friction: tuple[Observations, ServoGap],
) -> None:
    log, found = with_friction
    likelihood = ServoLikelihood(log)
    larger = []
    for one in neighbour_servos(found.servo, log.step):
        if one.structure.parts > found.servo.structure.parts:
            larger.append(one)
    tops: dict[frozenset[str], float] = {}
    for top in likelihood.maximise_from_starts(larger, 40):
        parts = top.structure.parts
        tops[parts] = max(top.value, tops.get(parts, -math.inf))
    assert tops
    assert min(tops.values()) > found.servo.value - 2.0  # a pole cannot be infinitely fast


def test_a_record_that_is_cut_in_motion_says_the_same(
    with_friction: tuple[Observations, ServoGap],
) -> None:
    log, found = with_friction
    first = int(found.crossings.at[0]) - 12
    moving = np.abs(np.diff(log.y))[first] + log.quantum
    assert moving > 0
    part_of_log = slice(first, None)
    part = build_observations(
        log.u[part_of_log], log.y[part_of_log], log.ok[part_of_log], START, STEP
    )
    cut = identify_servo_gap(part)
    assert cut is not None
    assert cut.gap.value * log.y_scale == pytest.approx(
        found.gap.value, abs=found.gap.half_width + cut.gap.half_width * log.y_scale
    )


def test_a_gap_that_is_worn_in_one_place_is_reported() -> None:
    u, y = logged(MOTOR._replace(friction=0.0, gap=0.0, quantum=0.0, spring=40.0), torque=0.0)
    z, level = y, float(y[0])
    worn = np.empty(z.size)
    for k, value in enumerate(z):
        half = 0.015 * (1 + 0.8 * np.tanh(2 * value / z.std()))
        level = max(min(level, value + half), value - half)
        worn[k] = 0.001 * round(level / 0.001)
    found = answered(u, worn)
    text = " ".join([*found.reasons, *found.crossings.describe_trends()])
    assert "crossing" in text


def test_a_gap_of_half_a_tick_is_no_more_than_one_tick() -> None:
    u, y = logged(MOTOR._replace(gap=0.001))
    found = answered(u, y)
    assert found.gap.low <= 0.001 <= found.gap.high < 0.004
    assert found.is_gap_reported or any("below" in reason for reason in found.reasons)


def test_too_few_reversals_give_no_gap() -> None:
    u, y = logged(MOTOR)
    found = answered(u[:400], y[:400])
    assert any("turn" in reason for reason in found.reasons)
    still = build_observations(u, np.zeros(SIZE), np.ones(SIZE, bool), START, STEP)
    assert still is None
    assert identify_servo_gap(None) is None


def test_a_loop_is_detected() -> None:
    """By what u does at a tick; 30 random logs, of which no open one may be called a loop."""
    right, loops = 0, 0
    for seed in range(30):
        log = random_log(900 + seed, 2000)
        found = tick_loop_p_value(log.u, log.y) < CHANCE
        assert log.closed or not found
        right, loops = right + found, loops + log.closed
    assert right >= 0.7 * loops


def test_an_encoder_is_known_by_its_changes() -> None:
    rng = np.random.default_rng(0)
    ticks = np.cumsum(rng.integers(-40, 41, 500))
    assert common_spacing(np.unique(0.003 * ticks)) == pytest.approx(0.003)
    assert common_spacing(np.unique(rng.standard_normal(500))) == 0.0


def test_what_a_play_passes_on_has_the_moments_of_a_gaussian() -> None:
    mean, variance, half = ca.SX.sym("m"), ca.SX.sym("v"), ca.SX.sym("h")
    through = ca.Function(
        "through", [mean, variance, half], list(predictor.dead_zone_moments(mean, variance, half))
    )
    grid = np.linspace(-12, 12, 200_001)
    for m, s, h in ((0.3, 1.0, 0.5), (-2.0, 0.4, 1.0), (0.0, 2.0, 0.1)):
        x = m + s * grid
        weights = norm.pdf(grid) * (grid[1] - grid[0])
        passed = np.sign(x) * np.maximum(np.abs(x) - h, 0.0)
        expected = float(weights @ passed)
        slope = float(weights @ (np.abs(x) > h))
        left = float(weights @ passed**2) - expected**2 - slope**2 * s**2
        found = [float(one) for one in through(m, s * s, h)]
        assert found == pytest.approx([expected, slope, max(left, 0.0)], abs=2e-4)


def test_crossings_have_a_median_and_a_scatter() -> None:
    gap = np.array([1.0, 1.1, 0.9, 1.0, 5.0])
    none = np.zeros(5)
    table = GapCrossings(none.astype(int), none, none.astype(int), none, none, none, gap)
    assert table.median_gap == 1.0
    assert table.gap_scatter == pytest.approx(0.14826, rel=1e-5)
    assert table.describe_trends() == []
    empty = GapCrossings(*[none[:0]] * 7)
    assert math.isnan(empty.median_gap)
    assert math.isnan(empty.gap_scatter)


@pytest.mark.long("test_a_filter_with_the_torques_of_a_servo_follows_its_log")
@needs("compiler", "gcc")
def test_a_late_log_ends_in_firmware_that_has_followed_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(exporting, "STEPS", 2000)
    u, y = logged(MOTOR._replace(delay=3))
    write_log(u, y)
    words = ["identify", "log.csv", "--order", "2", "--chain", "fw"]
    assert not group.main(words, standalone_mode=False)
    out = capsys.readouterr().out
    assert "Backlash: 0." in out
    assert "crossings" in out
    numbers = json.loads(Path("log-identify/identify.json").read_text(encoding="utf-8"))
    servo = numbers["servo"]
    assert servo["damping"] == pytest.approx(6.0, rel=0.05)
    assert servo["gain"] == pytest.approx(8.0, rel=0.05)
    assert servo["friction"] == pytest.approx(0.12, abs=0.03)
    assert len(servo["crossings"]["gap"]) == len(servo["crossings"]["t"]) > 10
    page = Path("log-identify/report.html").read_text(encoding="utf-8")
    assert "The gap at each crossing" in page
    motor, gap, *_ = ElementTree.parse("log-identify/gears.xml").iter("joint")
    assert float(motor.get("armature", 0)) == pytest.approx(1 / 8, rel=0.05)
    low, high = map(float, gap.get("range", "").split())
    assert (low, high) == pytest.approx((-0.015, 0.015), abs=5e-4)
    scenario = parse(Path("log.toml").read_text(encoding="utf-8"))
    assert (scenario.sensor.kind, scenario.plant.delay) == ("play", 3)
    assert scenario.sensor.quantum == pytest.approx(MOTOR.quantum)
    assert "every bit agrees" in out
    with np.load("fw/estimate.npz") as estimate:
        assert estimate["u"].shape == (SIZE, 1)
    hidden, left = map(float, re.findall(r"rms \S+ - z ([\d.e-]+)", out))
    assert left < 1e-3 * hidden


@pytest.mark.long("test_friction_beside_a_spring_is_named_with_its_level")
def test_a_fast_damping_may_be_a_pole_and_the_pole_the_damping() -> None:
    """Of 30037 the roles were exchanged, beside a wrong gap: one pole fewer is the servo."""
    theta = np.zeros(len(At))
    theta[At.DAMPING], theta[At.POLE] = math.log(400.0), math.log(8.0)
    theta[At.GAIN], theta[At.SPRING], theta[At.DELAY] = 900.0, math.log(1000.0), 1.0
    fast = ServoStructure(frozenset({"pole", "spring"}))
    slow = ServoStructure(frozenset({"spring"}))
    fewer = [
        one for one in neighbour_servos(Fitted(fast, theta, 0.0), STEP) if one.structure == slow
    ]

    def response(one: Fitted) -> Floats:
        A, B, _ = discretise_servo(one.theta[None], STEP, False)
        x, z = np.zeros(4), np.empty(300)
        for k in range(z.size):
            x = A[0] @ x + B[0, :, 0]
            z[k] = x[0]
        return z

    full_response = response(Fitted(fast, fast.disable_absent_parts(theta), 0.0))
    apart = [
        float(np.abs(response(one) - full_response).max() / np.ptp(full_response)) for one in fewer
    ]
    assert min(apart) < 0.03
    log = random_log(30037)
    found = answered(log.u, log.y, log.step)
    assert holds(found.gap, log.servo.gap)


def with_errors(e: Floats) -> ErrorSlopes:
    """Errors of deviation 1."""
    return ErrorSlopes(e, np.zeros(e.size), np.zeros((e.size, 1)), np.zeros((e.size, 1)))


@pytest.mark.parametrize(("follows", "lag", "named"), [(0.0, 1, 0), (0.25, 1, 1), (-0.25, 7, 1)])
def test_errors_of_noisy_readings_that_follow_others_are_no_servos(
    follows: float, lag: int, named: int
) -> None:
    """A gap four times the noise was told 2.8 times too wide, +- 29 %, beside such errors."""
    u, y = logged(MOTOR, noise=0.002)
    log, rng = listened(u, y), np.random.default_rng(8)
    white = rng.standard_normal(np.count_nonzero(log.error_samples(False)))
    coloured = lfilter([1.0], [1.0, *np.zeros(lag - 1), -follows], white)
    reasons = collect_odd_errors(log, with_errors(coloured))
    assert sum("follow" in reason for reason in reasons) == named


def test_what_overflows_is_no_servo() -> None:
    """The log of a motor that moved by a tick now and then had an error for an answer."""
    log = random_log(60074)
    assert identify_servo_gap(listened(log.u, log.y, log.step)) is None


def test_a_filter_with_the_torques_of_a_servo_follows_its_log() -> None:
    """Friction and slow torques were no part of the scenario: the filter learnt them as noise."""
    log = random_log(30036)
    found = identify_log(log)
    assert isinstance(found, uz.Identified)
    text = found.scenario()
    servo = found.answer.element.fit
    rms, time = re.findall(r"^(?:disturbance|correlation_time) = (\S+)", text, re.MULTILINE)
    assert (float(rms), float(time)) == pytest.approx(servo.motor_disturbance)

    def follow(text: str) -> tuple[float, bool | None]:
        """Return the rms of y - z^ in gaps, and whether the log fits."""
        followed = uz.estimate(parse(text), u=log.u, y=log.y, smoothing=False)
        late = (log.y - followed.z_hat[:, 0])[log.y.size // 5 :]
        return float(np.sqrt(np.mean(late**2))) / log.servo.gap, followed.info.consistent

    apart, fits = follow(text)
    lost, excused = follow(re.sub(r"(?m)^(disturbance|correlation_time) = .*$", "", text))
    assert (fits, excused) == (True, False)
    assert apart < 0.75
    assert lost > 2 * apart


def test_motors_and_lags_climb_side_by_side(with_friction: tuple[Observations, ServoGap]) -> None:
    log, found = with_friction
    lag = Fitted(
        found.servo.structure._replace(parts=frozenset(), lag=True), found.servo.theta, 0.0
    )
    tops = ServoLikelihood(log).maximise_from_starts([lag, found.servo], 2)
    assert [top.structure.lag for top in tops] == [True, False]
    assert tops[1].value >= found.servo.value - 1e-6


def gap_found(probability: float, low: float, few: bool, integrates: bool) -> Any:
    """What a servo's predictor found, as far as its name depends on it."""
    return SimpleNamespace(
        gap_probability=probability,
        gap=Interval(0.5, low, 0.6),
        has_few_reversals=few,
        is_integrating=integrates,
    )


def test_a_servo_is_likely_beside_words_that_name_nothing() -> None:
    sure = gap_found(0.99, 0.4, True, True)
    assert all(selection._has_likely_gap(sure, word) for word in ("undecided", "unclear", "none"))
    assert not selection._has_likely_gap(sure, "dead_zone")
    assert not selection._has_likely_gap(gap_found(0.5, 0.4, True, True), "undecided")
    assert not selection._has_likely_gap(gap_found(0.99, 0.4, False, True), "undecided")
    assert not selection._has_likely_gap(None, "undecided")


def test_only_an_undecided_record_has_the_word_of_its_odds() -> None:
    verdict = SimpleNamespace(word="undecided")
    found: Any = SimpleNamespace(verdict=verdict, odds={"input_zone": 0.6})
    assert selection._likeliest_word(found) == "input_zone"
    found.verdict.word = "dead_zone"
    assert selection._likeliest_word(found) == "dead_zone"


@pytest.mark.parametrize(
    ("prior", "half"), [(0.0, 0.1), (0.3, math.hypot(0.1, 0.6)), (None, math.inf)]
)
def test_an_offset_widens_the_sides_of_a_play_but_not_its_gap(
    prior: float | None, half: float
) -> None:
    case: Any = SimpleNamespace(offset_prior=prior, record_data=SimpleNamespace(y_scale=2.0))
    servo = gap_found(0.99, 0.4, True, True)
    centre = Interval.from_half_width(0.2, 0.1)
    found = selection._servo_widths(case, servo, centre)
    assert found["width"] == servo.gap
    assert found["centre"] is not None
    assert found["centre"].half_width == pytest.approx(half)
    if math.isfinite(half):
        assert [found[side].value for side in ("right", "left")] == pytest.approx([0.45, 0.05])


def test_the_covariance_of_a_quantity_is_that_of_the_parameters() -> None:
    """Of one that is linear in them it is M V M'."""
    structure = ServoStructure(frozenset())
    places = structure.free_places(False, False)
    draw = np.random.default_rng(4)
    M, root = draw.normal(size=(3, len(At))), draw.normal(size=(places.size, places.size))
    found: Any = SimpleNamespace(
        servo=SimpleNamespace(structure=structure, theta=draw.normal(size=len(At))),
        log=SimpleNamespace(ticks=False),
        covariance=root @ root.T,
    )
    covariance = covariance_of(found, lambda theta: M @ theta)
    np.testing.assert_allclose(
        covariance, M[:, places] @ found.covariance @ M[:, places].T, rtol=1e-6
    )


def test_absent_parts_do_nothing() -> None:
    """No friction, no spring, no slow torque, and a pole that is infinitely fast."""
    theta = ServoStructure(frozenset()).disable_absent_parts(np.ones(len(At)))
    assert (theta[At.FRICTION], theta[At.LOAD]) == (0.0, 0.0)
    assert (np.exp(theta[At.SPRING]), np.exp(theta[At.SLOW])) == (0.0, 0.0)
    assert np.exp(-theta[At.POLE]) == 0.0
    assert theta[At.GAP] == 1.0


@pytest.mark.parametrize(("friction", "word"), [(0.0, "none"), (0.3, "friction")])
def test_a_servo_without_a_gap_has_friction_or_nothing(
    monkeypatch: pytest.MonkeyPatch, friction: float, word: str
) -> None:
    level = Interval(friction, friction - 0.1, friction + 0.1) if friction else None
    element: Any = SimpleNamespace(_replace=lambda **changes: changes)
    for name, value in (
        ("find_repetition", None),
        ("find_input_zone", None),
        ("friction_of", level),
        ("build_servo_element", element),
        ("total_delay", 0.25),
    ):
        monkeypatch.setattr(selection, name, lambda *given, value=value: value)
    servo: Any = SimpleNamespace(
        gap_probability=1e-5,
        log=SimpleNamespace(ticks=True),
        gap=SimpleNamespace(high=0.01),
        is_integrating=True,
    )
    case: Any = SimpleNamespace(options=None)
    before: Any = SimpleNamespace(models=(), _replace=lambda **changes: changes)
    found: Any = selection.without_gap(case, servo, before)
    assert found["odds"] == {word: 1 - 1e-5, "play": 1e-5}
    assert found["verdict"].word == found["element"]["kind"] == word
    assert found["friction"] is level


def test_a_spring_has_friction_if_its_level_is_known_and_the_load_rubs_too() -> None:
    """Both parts are felt at once without a gap, and a spring alone is left to other models."""
    structure = ServoStructure(frozenset({"friction", "load", "spring"}))
    free = list(structure.free_places(False, False))
    theta = np.zeros(len(At))
    theta[[At.FRICTION, At.LOAD]] = 0.03, 0.02
    covariance = np.zeros((len(free), len(free)))
    rubs = [free.index(At.FRICTION), free.index(At.LOAD)]
    covariance[np.ix_(rubs, rubs)] = 1e-4 * np.array([[1.0, -0.99], [-0.99, 1.0]])
    servo: Any = SimpleNamespace(
        servo=SimpleNamespace(structure=structure, theta=theta),
        covariance=covariance,
        log=SimpleNamespace(ticks=False, u_scale=2.0, y_scale=1.0),
        reversals=50,
        gap=Interval(0.0, -1e-6, 1e-6),
        gap_probability=1e-6,
        least_gap=1e-3,
        is_servo=True,
        has_bursts=False,
        is_gap_reported=False,
        is_integrating=False,
    )
    level = selection.friction_of(servo)
    assert level is not None
    assert level.value == pytest.approx(0.1)
    assert level.half_width < 0.02  # the sum is known better than its parts
    assert selection.has_no_gap(servo)
    servo.covariance = 1e3 * covariance
    assert selection.friction_of(servo) is None
    assert not selection.has_no_gap(servo)


def test_friction_beside_a_spring_is_named_with_its_level() -> None:
    """Before, it was play at the input, or a valve that sticks."""
    draw = np.random.default_rng([77, 0, 8])
    step, size = 0.01, 2000
    truth = Servo(25.0, 19.0, 354.0, 0.0, 0.25, 0.0, 0.0, 0, 0.0, 0.0)
    command = input_at_random(draw, size)
    torque = 0.1 * torque_at_random(draw, size, step)
    u, y = recorded(truth, step, command, torque, 1.5e-4 * draw.standard_normal(size), False)
    found: Any = uz.identify(t=step, u=u, y=y)
    assert found.verdict == "friction"
    numbers = found.numbers()
    assert numbers["odds"]["friction"] > 0.9
    _, low, high = numbers["friction"]
    assert low < truth.friction < high < low + 0.03
