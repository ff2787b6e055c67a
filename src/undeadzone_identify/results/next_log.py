"""Input to record next: it narrows the widest interval most, or separates two classes best.

Candidates are steps of both signs, slow triangles and sweeps of sines. They stay within the
amplitude of the log's own input, change no faster than it did, and move z no further. With the
derivatives J of what is read by the numbers of the fit, a number w'theta that a log gives to within
sd (w' (J'J)^-1 w)^1/2 is given by both logs to within

    sd (w' (J'J + K'K)^-1 w)^1/2,   K the derivatives along the candidate.                     (N1)

Of two models, the second is moved to where it differs least from the first along the candidate, at
what it costs along the log; half the squares that are left, over the noise, are the nats by which
the next log parts them. Noise is taken for white.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import chirp, sawtooth

from undeadzone.errors import InputError
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.util.arrays import Floats
from undeadzone_identify.models.elements import MapModel, PlayModel, dead_zone_map, identity_map
from undeadzone_identify.models.least_squares import FittedModel
from undeadzone_identify.models.measured import level_slopes
from undeadzone_identify.models.plant import RecordData
from undeadzone_identify.models.zone_fit import ZoneFit, fit_linear
from undeadzone_identify.results.assemble import Answer
from undeadzone_identify.selection.alternatives import Element
from undeadzone_identify.selection.servo import build_servo_element

SECONDS = 30.0  # that the next log lasts
# samples of it
FEWEST = 300
MOST = 20_000
PERIODS = (1.0, 4.0, 16.0)  # of candidates, in the slowest time constant of the plant
SIZES = (1.0, 0.5, 0.25)  # of the amplitude of the log's input
FURTHER = 1.2  # than z moved in the log, that it may move
GAINS = 0.9  # of an interval that is left, from which nothing is worth a record
PARTS_THEM = 3.0  # nats from which two names are parted


class NextLog(NamedTuple):
    """Input of the next log.

    Attributes:
        t: times (N) [s].
        u: inputs (N x m) [u].
        name: of the signal.
        what: that it is for: the number whose interval narrows, or the names that it parts.
        left: share of the interval that is left with both logs; None if names are parted.
        nats: by which it parts two names; None if an interval narrows.
        heads: of its columns, with units.
    """

    t: Floats
    u: Floats
    name: str
    what: str
    left: float | None
    nats: float | None
    heads: tuple[str, ...]

    @property
    def description(self) -> str:
        """Return the signal and its expected gain in words."""
        if self.left is None:
            gain = f"{self.what}: {self.nats:.3g} nats apart"
        else:
            gain = f"{self.what}: {100 * self.left:.0f} % of its interval are left with both logs"
        return f"{self.name} from rest, {self.t[-1]:.4g} s; {gain}"

    @property
    def input_table(self) -> str:
        """Return the input as CSV text."""
        rows = [",".join(self.heads)]
        for t, u in zip(self.t.tolist(), self.u.tolist(), strict=True):
            rows.append(",".join(f"{number:.9g}" for number in (t, *u)))
        return "\n".join(rows) + "\n"


class ModelAccount(NamedTuple):
    """Model of the log with its parameters, scaled."""

    model: Any
    theta: Floats

    def account_along(self, data: RecordData) -> ModelAccount:
        """Return the same model at rest, at the start of another record."""
        model = self.model.along(data)
        layout = model.simulator.layout
        own = self.model.simulator.layout
        return ModelAccount(model, layout.at_rest(own, self.theta))

    def information_rows(self, begins_at_rest: bool) -> tuple[Floats, Floats]:
        """Return the readings (N) and their derivatives without those by the start (N x
        K).
        """
        model = self.model
        x0 = self.model.simulator.layout.x0
        ok = model.simulator.data.ok
        y, slopes = (part[ok] for part in model.slopes(self.theta))
        of_start = (model.free >= x0.start) & (model.free < x0.stop)
        rows = slopes[:, ~of_start]
        unknown = [np.ones((len(y), 1))] if model.has_level else [np.zeros((len(y), 0))]
        if not begins_at_rest:
            unknown.append(slopes[:, of_start])
        basis = np.linalg.qr(np.hstack(unknown))[0]
        return y - basis @ (basis.T @ y) if begins_at_rest else y, rows - basis @ (basis.T @ rows)

    def interval_weights(self, name: str) -> Floats:
        """Return the row of right, left, width or centre, parameters of the start left
        out.
        """
        model = self.model
        x0 = model.simulator.layout.x0
        row = np.array(DIRECTIONS[name]) @ level_slopes(model.levels, self.theta, model.free)
        return np.asarray(row[(model.free < x0.start) | (model.free >= x0.stop)])


def best_next_log(answer: Answer) -> NextLog:
    """Return the candidate input that narrows the interval of the least known width most.

    If the log is undecided, it is the one that best separates the two likeliest classes.

    Args:
        answer: of the identification of one output.

    Raises:
        InputError: there are neither an interval nor two classes, or no candidate helps.
    """
    least_known = _least_known_width(answer)
    if least_known is not None:
        name, account = least_known
        scored = _score_by_interval(answer, name, account)
        return _require_gain(min(scored, key=lambda one: one.left or 0.0, default=None), name)
    first, second = _likeliest_pair(answer)
    scored = _score_by_separation(answer, first, second)
    names = f"{first} from {second}"
    return _require_gain(max(scored, key=lambda one: one.nats or 0.0, default=None), names)


def _require_gain(best: NextLog | None, what: str) -> NextLog:
    """Require that the best candidate gains something. Raise InputError."""
    gains = best is not None and (best.left or 0.0) < GAINS
    if best is None or not gains or (best.nats is not None and best.nats < PARTS_THEM):
        raise InputError(
            f"next: no input within the amplitude and the rate of this log's tells more of {what}."
            " Record with a larger or a faster one"
        )
    return best


# --- Models


def _least_known_width(answer: Answer) -> tuple[str, ModelAccount] | None:
    """Return the least known width and its model; None without a width."""
    servo = answer.case.servo
    element = answer.element
    if element is None and servo is not None and servo.has_few_reversals:
        element = build_servo_element(answer.case, servo)
    if element is not None:
        widths = element.widths
    elif answer.verdict == "dead_zone":
        widths = {name: getattr(answer, name) for name in DIRECTIONS}
    else:
        return None
    half = {}
    for name in ("width", "right", "left"):
        interval = widths[name]
        if interval is not None and math.isfinite(interval.high) and interval.high > interval.low:
            half[name] = (interval.high - interval.low) / max(abs(interval.value), 1e-300)
    if not half:
        return None
    widest = max(half, key=lambda name: half[name])
    return widest, _zone_account(answer.fit) if element is None else _element_account(element)


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


def _likeliest_pair(answer: Answer) -> tuple[str, str]:
    """Return the two likeliest classes. Raise InputError without a pair to separate."""
    known = _accounts_by_word(answer)
    likely = [word for word in answer.found.odds if word in known][:2]
    if answer.verdict != "undecided" or len(likely) < 2:
        raise InputError(
            f"next: of the verdict {answer.verdict} there is no interval to narrow, and no two"
            " names to part"
        )
    return likely[0], likely[1]


def _accounts_by_word(answer: Answer) -> dict[str, ModelAccount]:
    """Return models of the log by their classes."""
    fit = answer.fit
    found = answer.found
    plain = fit_linear(fit.objective.simulator, fit.objective.readings.ok)
    model = MapModel(fit.objective.simulator, "none", identity_map)
    accounts = {
        "none": ModelAccount(model, plain.theta[: model.base]),
        "dead_zone": _zone_account(fit),
    }
    fits = dict(found.places) | ({} if found.plays is None else dict(found.plays.fits))
    return accounts | {word: ModelAccount(one.model, one.theta) for word, one in fits.items()}


# --- Scores


def _score_by_interval(answer: Answer, name: str, account: ModelAccount) -> Iterator[NextLog]:
    """Yield the candidates with the share of an interval that each leaves."""
    row = account.interval_weights(name)
    (_, rows) = account.information_rows(begins_at_rest=False)
    information = rows.T @ rows
    scale = 1 / np.sqrt(np.diag(information) + 1e-300)
    information = information * np.outer(scale, scale) + 1e-12 * np.eye(scale.size)
    row = row * scale
    before = float(row @ np.linalg.solve(information, row))
    for kind, data in _candidate_records(answer, account):
        new = account.account_along(data).information_rows(begins_at_rest=True)[1] * scale
        after = float(row @ np.linalg.solve(information + new.T @ new, row))
        yield _to_next_log(answer, kind, data, name, math.sqrt(after / before), None)


def _score_by_separation(answer: Answer, first: str, second: str) -> Iterator[NextLog]:
    """Yield the candidates with the nats by which each separates two classes."""
    known = _accounts_by_word(answer)
    one = known[first]
    other = known[second]
    _, rows = other.information_rows(begins_at_rest=False)
    information = rows.T @ rows + 1e-9 * np.eye(rows.shape[1])
    noise = max(answer.chosen.error, answer.case.quantum / math.sqrt(12), 1e-6)
    for kind, data in _candidate_records(answer, one):
        here, _ = one.account_along(data).information_rows(begins_at_rest=True)
        there, new = other.account_along(data).information_rows(begins_at_rest=True)
        apart = here - there
        gradient = new.T @ apart
        left = float(
            apart @ apart - gradient @ np.linalg.solve(information + new.T @ new, gradient)
        )
        nats = max(left, 0.0) / (2 * noise**2)
        yield _to_next_log(answer, kind, data, f"{first} from {second}", None, nats)


def _to_next_log(
    answer: Answer, kind: str, data: RecordData, what: str, left: float | None, nats: float | None
) -> NextLog:
    """Convert a candidate to units of the log."""
    grid = answer.case.grid
    t = grid.step * np.arange(data.y.size)
    heads = ("t [s]", *(f"{name} [{grid.input_unit}]" for name in grid.inputs))
    return NextLog(t, data.u * data.u_scale, kind, what, left, nats, heads)


# --- Candidates


def _candidate_records(answer: Answer, account: ModelAccount) -> Iterator[tuple[str, RecordData]]:
    """Yield inputs within the log's limits that move z no further (name, record)."""
    own = account.model.simulator.data
    step = answer.case.grid.step
    size = int(np.clip(round(SECONDS / step), FEWEST, MOST))
    reach = FURTHER * float(np.ptp(answer.z))
    blank = np.zeros(size)
    integrates = account.model.simulator.layout.integrators > 0
    for kind, pattern in _unit_patterns(_slowest_constant(answer), size):
        for share in SIZES:
            u = np.column_stack(
                [_limit_pattern(column, share * pattern, integrates) for column in own.u.T]
            )
            turned = [np.roll(column, k * size // 2) for k, column in enumerate(u.T)]
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
    low = float(recorded.min())
    high = float(recorded.max())
    middle = (low + high) / 2
    amplitude = (high - low) / 2
    if integrates or low * high < 0:  # symmetric about 0
        middle = 0.0
        amplitude = min(-low, high)
    unlimited = middle + max(amplitude, 0.0) * pattern
    largest_step = float(np.abs(np.diff(recorded)).max())
    u = np.empty(unlimited.size)
    previous = middle
    for k, value in enumerate(unlimited.tolist()):
        previous += min(max(value - previous, -largest_step), largest_step)
        u[k] = previous
    return u
