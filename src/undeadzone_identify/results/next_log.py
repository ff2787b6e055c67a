"""Input to record next: it narrows the widest interval of the account most, however sure that is.

Candidates are steps of both signs, slow triangles and sweeps of sines. They stay within the
amplitude of the log's own input, change no faster than it did, and move z no further. With the
derivatives J of what is read by the numbers of the fit, a number w'theta that a log gives to within
sd (w' (J'J)^-1 w)^1/2 is given by both logs to within

    sd (w' (J'J + K'K)^-1 w)^1/2,   K the derivatives along the candidate.                     (N1)

Noise is taken for white.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import chirp, sawtooth

from undeadzone.errors import InputError
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.util.arrays import Flags, Floats
from undeadzone_identify.models.chain import limit_rates
from undeadzone_identify.models.elements import MapModel, PlayModel, dead_zone_map
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.models.least_squares import FittedModel, regression_residual
from undeadzone_identify.models.measured import level_slopes
from undeadzone_identify.models.plant import RecordData
from undeadzone_identify.models.zone_fit import ZoneFit
from undeadzone_identify.results.account import Account
from undeadzone_identify.results.assemble import Answer
from undeadzone_identify.results.speech import EFFECT_OF
from undeadzone_identify.selection.alternatives import Element, fit_of
from undeadzone_identify.selection.servo import build_servo_element

SECONDS = 30.0  # that the next log lasts
# samples of it
FEWEST = 300
MOST = 20_000
PERIODS = (1.0, 4.0, 16.0)  # of candidates, in the slowest time constant of the plant
SIZES = (1.0, 0.5, 0.25)  # of the amplitude of the log's input
FURTHER = 1.2  # than z moved in the log, that it may move
GAINS = 0.9  # of an interval that is left, from which nothing is worth a record


class NextLog(NamedTuple):
    """Input of the next log.

    Attributes:
        t: times (N) [s].
        u: inputs (N x m) [u].
        name: of the signal.
        what: that it is for: the number whose interval narrows.
        left: share of the interval that is left with both logs.
        heads: of its columns, with units.
    """

    t: Floats
    u: Floats
    name: str
    what: str
    left: float
    heads: tuple[str, ...]

    @property
    def description(self) -> str:
        """Return the signal and its expected gain in words."""
        gain = f"{self.what}: {100 * self.left:.0f} % of its interval are left with both logs"
        return f"{self.name} from rest, {self.t[-1]:.4g} s; {gain}"

    @property
    def input_table(self) -> str:
        """Return the input as CSV text."""
        text = io.StringIO()
        rows = np.column_stack([self.t, self.u])
        np.savetxt(text, rows, "%.9g", ",", header=",".join(self.heads), comments="")
        return text.getvalue()


class ModelAccount(NamedTuple):
    """Model of the log with its parameters, scaled."""

    model: Any
    theta: Floats

    @property
    def is_of_start(self) -> Flags:
        """Return the flags of the free numbers that are states at the start (K)."""
        return np.isin(self.model.free, np.r_[self.model.simulator.layout.x0])

    def account_along(self, data: RecordData) -> ModelAccount:
        """Return the same model at rest, at the start of another record."""
        model = self.model.along(data)
        layout = model.simulator.layout
        return ModelAccount(model, layout.at_rest(self.model.simulator.layout, self.theta))

    def information_rows(self, begins_at_rest: bool) -> Floats:
        """Return the derivatives of the readings without those by the start (N x K)."""
        model = self.model
        slopes = model.slopes(self.theta)[1][model.simulator.data.ok]
        of_start = self.is_of_start
        rows = slopes[:, ~of_start]
        unknown = [np.ones((len(rows), int(model.has_level)))]
        if not begins_at_rest:
            unknown.append(slopes[:, of_start])
        return regression_residual(np.hstack(unknown), rows)

    def interval_weights(self, name: str) -> Floats:
        """Return the row of right, left, width or centre, parameters of the start left
        out.
        """
        row = np.array(DIRECTIONS[name]) @ level_slopes(
            self.model.levels, self.theta, self.model.free
        )
        return row[~self.is_of_start]


def best_next_log(answer: Answer, account: Account) -> NextLog:
    """Return the candidate input that narrows the interval of the least known width most.

    Args:
        answer: of the identification of one output.
        account: of it.

    Raises:
        InputError: there is no interval, or no candidate helps.
    """
    name, model = _least_known_width(answer, account)
    best = min(_score_by_interval(answer, name, model), key=lambda one: one.left, default=None)
    if best is None or best.left >= GAINS:
        raise InputError(
            f"next: no input within the amplitude and the rate of this log's narrows {name}."
            " Record with a larger or a faster one"
        )
    return best


# --- Models


def _least_known_width(answer: Answer, account: Account) -> tuple[str, ModelAccount]:
    """Return the least known width and its model. Raise InputError without a width."""
    servo = answer.case.servo
    element = answer.element
    if element is None and servo is not None and servo.has_few_reversals:
        element = build_servo_element(answer.case, servo)
    numbers: Mapping[str, Interval | None] = account.first_numbers
    model = _zone_account(answer.fit)
    if element is not None:
        model = _element_account(element)
        numbers = element.widths
    elif answer.verdict != "dead_zone":
        words = (word for word, effect in EFFECT_OF.items() if effect in account.effects)
        fits = (fit_of(answer.case, answer.found, word) for word in words)
        fit = next(filter(None, fits), None)
        model, numbers = (
            (model, {}) if fit is None else (ModelAccount(fit.model, fit.theta), numbers)
        )
    widths = {"width": numbers.get("gap", numbers.get("level")), **numbers}
    half = {}
    for name in ("width", "right", "left"):
        interval = widths.get(name)
        if interval is not None and interval.low < interval.high < math.inf:
            half[name] = (interval.high - interval.low) / max(abs(interval.value), 1e-300)
    if not half:
        raise InputError(f"next: of the grade {account.grade} there is no interval to narrow")
    return max(half, key=lambda name: half[name]), model


def _zone_account(fit: ZoneFit) -> ModelAccount:
    """Return the model of a dead zone of the sensor."""
    model = MapModel(fit.objective.simulator, "dead_zone", dead_zone_map)
    return ModelAccount(model, np.append(fit.theta[: model.base], [fit.right, fit.left]))


def _element_account(element: Element) -> ModelAccount:
    """Return the model of a play, or of a zone of the input."""
    if isinstance(element.fit, FittedModel):
        return ModelAccount(element.fit.model, element.fit.theta)
    model = PlayModel(element.simulator)
    gap = element.widths["width"]
    scale = model.data.y_scale
    assert gap is not None
    half = gap.value / 2 / scale
    return ModelAccount(model, np.append(element.theta[: model.base], [half, half, 0.0, 0.0]))


# --- Scores


def _score_by_interval(answer: Answer, name: str, model: ModelAccount) -> Iterator[NextLog]:
    """Yield the candidates with the share of an interval that each leaves."""
    grid = answer.case.grid
    heads = ("t [s]", *(f"{one} [{grid.input_unit}]" for one in grid.inputs))
    row = model.interval_weights(name)
    rows = model.information_rows(begins_at_rest=False)
    scale = 1 / np.sqrt(np.sum(rows**2, axis=0) + 1e-300)
    rows = rows * scale
    information = rows.T @ rows + 1e-12 * np.eye(scale.size)
    row = row * scale
    before = row @ np.linalg.solve(information, row)
    for kind, data in _candidate_records(answer, model):
        new = model.account_along(data).information_rows(begins_at_rest=True) * scale
        after = row @ np.linalg.solve(information + new.T @ new, row)
        t = grid.step * np.arange(data.y.size)
        left = math.sqrt(after / before)
        yield NextLog(t, data.u * data.u_scale, kind, name, left, heads)


# --- Candidates


def _candidate_records(answer: Answer, account: ModelAccount) -> Iterator[tuple[str, RecordData]]:
    """Yield inputs within the log's limits that move z no further (name, record)."""
    own = account.model.simulator.data
    size = int(np.clip(round(SECONDS / answer.case.grid.step), FEWEST, MOST))
    reach = FURTHER * np.ptp(answer.z)
    blank = np.zeros(size)
    integrates = account.model.simulator.layout.integrators > 0
    for kind, pattern in _unit_patterns(_slowest_constant(answer), size):
        for share in SIZES:
            columns = [_limit_pattern(one, share * pattern, integrates) for one in own.u.T]
            turned = [np.roll(column, k * size // 2) for k, column in enumerate(columns)]
            data = own._replace(
                u=np.column_stack(turned),
                y=blank,
                ok=blank == 0,
                start=np.zeros(1, int),
                side=np.zeros(size, int),
                climbs=None,
            )
            moved = account.account_along(data)
            if np.ptp(moved.model.output(moved.theta)) <= reach:
                yield kind, data


def _slowest_constant(answer: Answer) -> float:
    """Return the slowest time constant of the plant [samples]."""
    rates = np.abs(answer.poles) * answer.case.grid.step
    moving = rates[np.isfinite(rates) & (rates > 1e-4)]
    return float(1 / moving.min()) if moving.size else 50.0


def _unit_patterns(slowest: float, size: int) -> Iterator[tuple[str, Floats]]:
    """Yield signals between -1 and 1 (name, N)."""
    k = np.arange(size)
    draw = np.random.default_rng(0)
    periods = {float(np.clip(share * slowest, 20, size / 6)) for share in PERIODS}
    for period in sorted(periods):
        halves = draw.uniform(0.3, 1.0, math.ceil(size / period))
        levels = np.column_stack([halves, -halves]).ravel()  # as far back as forth
        yield "steps", levels[(2 * k / period).astype(int)]
        yield "a triangle", sawtooth(2 * np.pi * k / period + np.pi / 2, 0.5)
        yield "a sweep of sines", chirp(k, 0.25 / period, size, 2 / period, phi=-90)


def _limit_pattern(recorded: Floats, pattern: Floats, integrates: bool) -> Floats:
    """Scale a pattern to the range of a recorded input and limit its rate to that input's (N).

    Args:
        recorded: the recorded input.
        pattern: values between -1 and 1 (N).
        integrates: whether the plant integrates. Then the pattern has mean 0, else z drifts.
    """
    low, high = recorded.min(), recorded.max()
    middle = (low + high) / 2
    amplitude = (high - low) / 2
    if integrates or low * high < 0:  # symmetric about 0
        middle = 0.0
        amplitude = min(-low, high)
    unlimited = np.append(middle, middle + max(amplitude, 0.0) * pattern)
    return limit_rates(unlimited, np.abs(np.diff(recorded)).max(keepdims=True))[1:, 0]
