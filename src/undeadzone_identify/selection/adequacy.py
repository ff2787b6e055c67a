"""Score tests of the innovations of the likeliest model.

Odds compare models with each other: the best of them may still be wrong. The innovations of a right
model are independent of all known signals. They are regressed on the traces of wrong models, after
the effect of the model's own parameters is removed (Rao 1948; White 1982). One regression a
direction and no fit is needed.

References:
    H. White (1982), doi:10.2307/1912526
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.polynomial.hermite_e import hermegauss

from undeadzone.util.arrays import Flags, Floats, rows_since_start, shift_rows
from undeadzone.util.files import read_table
from undeadzone_identify.models import least_squares
from undeadzone_identify.models.chain import ChainModel, lag_columns, limit_rates
from undeadzone_identify.models.least_squares import (
    CHANCE,
    LEAST_ODD,
    FittedModel,
    Model,
    describe_p_value,
)
from undeadzone_identify.models.place import PlaceModel

SHARE = 0.045  # of the innovations' variance, from which a direction is real if p is below CHANCE
# The same of directions of few columns.
OF_FEW = dict.fromkeys(("beside", "ahead", "spring", "repetition"), 0.025)
LARGE_SHARE = 0.1
MOST, HARDLY = 0.5, 0.1  # the same for most of the residual that is not white, and its largest p
# The same of a large share, and of one between both, of which p may be larger.
REAL = ((MOST, HARDLY), (LARGE_SHARE, 0.02), (0.05, 0.003))
BLURRED = 0.2  # largest rms of a residual that may be a disturbance of z [rms of the readings]
NODES = 7  # of a mean over that disturbance
BEGIN = 12  # samples of a record whose innovations lack a past
AT_INPUT, AT_SENSOR = 7, 8  # hat functions of the input, and of z
AT_LEVELS = 16  # of the input, so that they show its steps
RATES = (0.1, 0.25, 0.5, 1.0, 2.0)  # rms of a signal's changes, that its rate may be limited to
BEHIND = 5  # lags of the readings
WIDER = (1.0, 1.06, 1.12, 1.18)  # times a fitted jump: steps that may be behind it
AHEAD = np.exp(-1 / np.array([1.0, 3.0, 8.0]))  # poles of a lag ahead of the input's element
VANISHING = 1e-6  # of a column: one that the model's own numbers explain
NONE_EXPLAINS = "no known model explains this log"
SURE = 2.0  # deviations, from which a weight counts
ALIKE = 1e-3  # of the largest singular value: columns that say the same
_TABLES = read_table(__file__)
DEPENDS, SEEN = _TABLES["depends"], _TABLES["seen"]
COARSE = {  # least share of models that are coarse themselves, by direction
    # It holds the plant by the sample, when it turns and where it rests.
    "friction": {"output": 0.2, "turns of the output": LARGE_SHARE, "rate of the input": 0.2},
    # It blurs its corners, each of which shifts the samples behind.
    "jump": dict.fromkeys(DEPENDS, 0.25) | {"behind": math.inf, "steps": 0.05},
}


class Remainder(NamedTuple):
    """Dependence of a model's innovations on a known signal.

    Attributes:
        on: the direction, of `DEPENDS`.
        share: of their variance that it explains.
        chance: p of that.
        moves: by how much the model's free numbers would change with it.
    """

    on: str
    share: float
    chance: float
    moves: Floats

    @property
    def is_most(self) -> bool:
        """Return whether most of the residual depends on the signal."""
        return self.share > MOST and self.chance < HARDLY

    @property
    def is_real(self) -> bool:
        """Return whether a model that leaves this is wrong."""
        rows = (*REAL, (OF_FEW.get(self.on, SHARE), CHANCE))
        return any(self.share > share and self.chance < chance for share, chance in rows)

    def in_words(self, model: str) -> tuple[str, str]:
        """Return the finding, and the recording that shows its cause.

        Args:
            model: the model in words.
        """
        on = f"{DEPENDS[self.on]} ({100 * self.share:.0f} % of it, {describe_p_value(self.chance)})"
        seen = f"the residual of the best one, {model}, depends on {on}"
        finding = f"{NONE_EXPLAINS}: {seen}. Nothing is named"
        return finding, SEEN[self.on]


def largest_remainder(remainders: Sequence[Remainder], word: str) -> Remainder | None:
    """Return the largest dependence of a model's innovations, None if not significant.

    Args:
        remainders: of the model.
        word: the verdict's for it.
    """
    least = COARSE.get(word, {})
    real = [one for one in remainders if one.is_real and one.share > least.get(one.on, 0.0)]
    names = {one.on for one in real}  # levels of the input show its curves, too
    own = [one for one in real if one.on != "levels of the input" or "input" not in names]
    return max(own, key=lambda one: one.share, default=None)


def find_remainders(fit: FittedModel[Model], raw: Collection[str] = ("spring",)) -> list[Remainder]:
    """Return the dependence of a model's innovations on each direction.

    Args:
        fit: the model; one that leaves next to nothing is not wrong.
        raw: directions that most of the residual may not depend on, either. To whiten what a slow
            plant leaves takes most of it away; but a slow disturbance in a short log depends on
            anything.
    """
    if not LEAST_ODD < fit.density.rms < math.inf:
        return []
    squares = fit.squares.fit_coloured(fit.theta)
    data = squares.data
    use, own, e = _residual_and_own(fit)
    if use.sum() < 4 * own.shape[1]:
        return []
    found = []
    for name, columns in _directions(fit).items():
        signals = (own, e, _centre(columns, data.ok))
        tested = _remainder(name, fit, *(squares.whiten(one)[use] for one in signals))
        if name in raw:
            slow = _remainder(name, fit, *(one[use] for one in signals))
            tested = slow if slow is not None and slow.is_most else tested
        found.append(tested)
    return list(filter(None, found))


def explains_more_bent(linear: FittedModel[Model], larger: FittedModel[Model]) -> bool:
    """Return whether a linear plant whose spring bends explains more than a larger model.

    Args:
        linear: fit of the linear plant.
        larger: fit of the same readings.
    """
    use, own, e = _residual_and_own(linear)
    if use.sum() < 4 * own.shape[1]:
        return False
    bent = _centre(_bent_force(linear, linear.model.output(linear.theta)), linear.squares.data.ok)
    spring = _remainder("spring", linear, *(one[use] for one in (own, e, bent)))
    if spring is None or spring.chance > HARDLY:
        return False
    # By BIC: a bend has as many numbers as columns.
    numbers = linear.model.free.size + bent.shape[1] - larger.model.free.size
    price = numbers * math.log(len(bent)) / use.sum()
    gain = 2 * math.log(larger.density.rms / linear.density.rms) - math.log(
        max(1 - spring.share, 1e-12)
    )
    return gain > price


def _residual_and_own(fit: FittedModel[Model]) -> tuple[Flags, Floats, Floats]:
    """Return flags of samples with a past (N), the derivatives by the model's own parameters
    (N x P) and its residual (N).
    """
    data = fit.squares.data
    use = data.ok & (rows_since_start(data.start, data.y.size) >= BEGIN)
    e, rows = fit.squares.residual_and_slopes(fit.theta)
    own = np.column_stack([rows, np.ones(len(rows)), _blurred_readings(fit)])
    return use, own, e


def _blurred_readings(fit: FittedModel[Model]) -> Floats:
    """Return by how much a disturbance of z changes the mean readings of a bent sensor (N x 1).

    A disturbance rounds the corners of a zone or of limits in the mean. There is no column for a
    model whose edges are round, or whose residual is larger than that of a disturbance.
    """
    model = fit.model
    z = fit.model.output(fit.theta)
    rms = fit.density.rms
    if rms > BLURRED or (isinstance(model, ChainModel) and model.shaped):
        return np.empty((z.size, 0))
    nodes, weights = hermegauss(NODES)
    read = [model.noise_free_readings(z + rms * node, fit.theta) for node in nodes]
    blurred = weights / weights.sum() @ np.array(read)
    return (blurred - model.noise_free_readings(z, fit.theta))[:, None]


def _centre(columns: Floats, ok: Flags) -> Floats:
    """Return columns less their means; 0 if a reading is missing (N x K)."""
    return np.where(ok[:, None], columns - columns[ok].mean(axis=0), 0.0)


def _remainder(
    name: str, fit: FittedModel[Model], own: Floats, residual: Floats, columns: Floats
) -> Remainder | None:
    """Regress a residual on the columns of a direction; None if the model explains them.

    Args:
        name: of the direction.
        fit: of the model.
        own: derivatives by these, and other columns of the model (N x P).
        residual: of the model (N).
        columns: of the direction (N x K).
    """
    left, as_own = _left_over(own, columns)
    if not left.size:
        return None
    target = least_squares.regression_residual(own, residual)
    weights, std, share, chance = least_squares.regress_residual(left, target)
    sure = np.where(np.abs(weights) > SURE * std, weights, 0.0)
    return Remainder(name, share, chance, as_own[: fit.model.free.size] @ sure)


def _left_over(own: Floats, columns: Floats) -> tuple[Floats, Floats]:
    """Return the parts of columns beyond the model's own parameters, orthogonal, of rms 1.

    Returns:
        The parts (N x K), no column if the parameters explain all; and the change of the parameters
        that stands for each (P x K).
    """
    as_own = np.linalg.lstsq(own, columns, rcond=1e-10)[0]
    left = columns - own @ as_own
    scale = left.std(axis=0)
    kept = scale > VANISHING * np.maximum(columns.std(axis=0), 1e-12)
    if not kept.any():
        return left[:, kept], as_own[:, kept]
    basis, sizes, turn = np.linalg.svd(left[:, kept] / scale[kept], full_matrices=False)
    most = sizes > ALIKE * sizes[0]
    root = math.sqrt(len(left))
    return basis[:, most] * root, (as_own[:, kept] / scale[kept] @ turn.T / sizes)[:, most] * root


def _directions(fit: FittedModel[Model]) -> dict[str, Floats]:
    """Return the traces of wrong models, by direction (N x K each)."""
    model = fit.model
    theta = fit.theta
    data = model.simulator.data
    z = model.output(theta)
    through_plant = model.simulator.respond_from_rest
    read = model.noise_free_readings(z, theta)
    u = data.u[:, 0]
    t = np.linspace(-1.0, 1.0, z.size)
    directions = {
        "input": through_plant(theta, hat_columns(u, AT_INPUT)),
        "levels of the input": through_plant(theta, hat_columns(u, AT_LEVELS)),
        "output": hat_columns(z, AT_SENSOR),
        "turns of the input": through_plant(theta, by_last_turn(u)),
        "turns of the output": by_last_turn(z),
        "time": read[:, None] * np.column_stack([t, t * t, np.sin(np.pi * t), np.cos(np.pi * t)]),
        "rate of the input": through_plant(theta, _late_by_rate(u)),
        "rate of the output": _late_by_rate(z),
    }
    if np.std(read - z) > 0:  # else these are more poles of the plant
        lags = [(read, k) for k in range(1, BEHIND + 1)] + [(read - z, k) for k in range(1, 4)]
        late = [shift_rows(signal, k, data.start) for signal, k in lags]
        directions["behind"] = np.column_stack(late)
    if model.name == "jump":  # a sensor of equal steps has one about 0, which the fit narrows
        angle = 2 * np.pi * z[:, None] / (model.levels(theta).sum() * np.array(WIDER))
        directions["steps"] = np.column_stack([np.sin(angle), np.cos(angle)])
    if isinstance(model, ChainModel | PlaceModel):
        passed = model.pass_input(u, theta)
        if np.std(passed - u) > 0:
            behind = [model.pass_input(lag_columns(u, pole), theta) - passed for pole in AHEAD]
            directions["ahead"] = through_plant(theta, np.column_stack(behind))
            if isinstance(model, PlaceModel):  # one column finds what the hats of the input share
                directions["beside"] = through_plant(theta, u[:, None])
    return directions | {"spring": _bent_force(fit, z)}


def _bent_force(fit: FittedModel[Model], z: Floats) -> Floats:
    """Return the response of the plant to forces that are no line of its output (N x 3)."""
    force = z / max(float(np.std(z)), 1e-12)
    bent = np.column_stack([force**2, force**3, force * np.abs(force)])
    return fit.model.simulator.respond_from_rest(fit.theta, bent)


def hat_columns(values: Floats, count: int) -> Floats:
    """Return hat functions of a signal (N x K)."""
    centres = np.unique(np.quantile(values, np.linspace(0.01, 0.99, count)))
    return least_squares.hat_functions(values, centres)


def by_last_turn(signal: Floats) -> Floats:
    """Return the sign of a signal's last move, 0 before it moved, alone and times the signal
    (N x 3).
    """
    sign = np.sign(np.diff(signal, prepend=signal[0]))
    turn = sign[np.maximum.accumulate(np.where(sign != 0, np.arange(sign.size), 0))]
    return np.column_stack([turn, turn * signal, turn * np.abs(signal)])


def _late_by_rate(signal: Floats) -> Floats:
    """Return by how much limits of its rate would change a signal, and its speed (N x K)."""
    usual = np.std(np.diff(signal))
    speed = np.abs(np.diff(signal, prepend=signal[0]))  # a lag that differs by direction
    late = limit_rates(signal, usual * np.array(RATES)) - signal[:, None]
    return np.column_stack([late, speed])
