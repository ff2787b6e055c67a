"""Moving horizon estimation: the likeliest motion over the last samples.

Edges and ranges are its constraints (docs/methods/nonlinear_filters.md).
"""

from __future__ import annotations

from functools import partial
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import (
    Estimate,
    Observer,
    PythonObserver,
    Reading,
    Traits,
    build_python_observer,
)
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.numerics.gaussian import CLIP
from undeadzone.observers.filtering.augmented_state import quarter_period
from undeadzone.observers.filtering.prior import (
    Doubt,
    doubt_numbers,
    outlier_probability,
    require_sample_time,
)
from undeadzone.observers.filtering.recovery import LIMIT, TOO_MANY
from undeadzone.plants.system import System
from undeadzone.util.arrays import Array, Floats, require_nonnegative, require_number
from undeadzone_arena.observers.parts import window as horizon
from undeadzone_arena.observers.parts.joint_claims import (
    JointAssumptions,
    JointPrior,
    build_joint_prior,
    glitch_probability,
    numeric_estimate,
)
from undeadzone_arena.observers.parts.tangents import Tangents, model_tangents
from undeadzone_arena.observers.parts.window import HorizonWeights, Window

NODES = 40  # of a horizon, if the period is not given


class MovingHorizon(JointAssumptions, frozen=True, kw_only=True, tag="moving_horizon"):
    """Moving horizon estimation of `[x; d_r; d_l]`, Rao, Rawlings, Mayne (2003), sampled time.

    The widths stay in their range. By default noise is at least 1 % of the range, x_std five times
    and drift 0.5 % of the largest width. It runs in Python: in single runs only.

    References:
        C. V. Rao, J. B. Rawlings, D. Q. Mayne (2003), doi:10.1109/TAC.2002.808470

    Attributes:
        horizon: length of the horizon [s] (default a quarter period of the plant, 50 samples if it
            only integrates).
        period: time between the readings that are used, and between solutions [s] (default a
            fortieth of the horizon).
        slack: rms by which a silent sensor's z may be outside its zone, one or one per output [z]
            (default noise).
        solver: solver of CasADi, exact ("daqp") or by alternating directions ("osqp").
    """

    horizon: float | None = None
    period: float | None = None
    slack: Array | None = None
    solver: Literal["daqp", "osqp"] = "daqp"

    def build(self, model: System, sensor: Zone) -> Observer:
        """Build the estimator for a sampled model."""
        if sensor.kind == "jump":
            raise InputError(
                "observer.method: 'moving_horizon' takes a reading for z - d_r or z + d_l, which "
                "that of a jump sensor is not. Use 'censored'"
            )
        if not ca.has_conic(self.solver):
            raise InputError(
                f"observer.solver: this CasADi ({ca.__version__}) has no {self.solver!r}. Choose "
                "another of daqp, osqp"
            )
        nodes, stride = self._horizon_grid(model)
        prior = build_joint_prior(self, model, sensor, stride=stride)
        rms = np.sqrt(prior.prior.R)
        slack = rms
        if self.slack is not None:
            slack = require_nonnegative("observer.slack", self.slack, model.p, "one per output")
        if not slack.all():
            raise InputError(
                "observer.slack: must be positive, found 0: noise alone would leave no solution"
            )
        share = outlier_probability(self.glitches)
        setup = HorizonSetup(
            model=model,
            sensor=sensor,
            prior=prior,
            weights=HorizonWeights(rms, slack, prior.prior.gate / sensor.slope, prior.ranges),
            stride=stride,
            rms=np.sqrt(prior.variance / stride),
            doubt=doubt_numbers(model, sensor, prior.prior, share, is_assumed=False)
            if share
            else None,
            tangents=model_tangents(model),
        )
        return build_moving_horizon(setup, nodes, self.solver)

    def _horizon_grid(self, model: System) -> tuple[int, int]:
        """Return the intervals of the horizon and the samples of an interval.

        Raises InputError.
        """
        Ts = require_sample_time(model)
        if self.horizon is None:
            length = quarter_period(model)
        else:
            length = require_number("observer.horizon", self.horizon, above=0.0)
        if self.period is None:
            period = length / NODES
        else:
            period = require_number("observer.period", self.period, above=0.0)
        stride = max(1, round(period / Ts))
        nodes = max(1, round(length / (stride * Ts)))
        if nodes > 500:
            raise InputError(
                f"observer.period: expected at most 500 periods in the horizon, found {nodes}"
            )
        return nodes, stride


class HorizonState(NamedTuple):
    """State of the estimator between samples.

    Attributes:
        window: the nodes.
        X: `[x; d_r; d_l]` now (n + 2p).
        cov: covariance at the newest node (n + 2p x n + 2p).
        F, f, G: x now = F x + f + G w of that node's x (n x n, n, n x m).
        since: samples since that node.
        share: mean share of refused readings of late (p).
    """

    window: Window
    X: Floats
    cov: Floats
    F: Floats
    f: Floats
    G: Floats
    since: int
    share: Floats


class HorizonSetup(NamedTuple):
    """Fixed parts of one estimator.

    Attributes:
        model: the sampled model.
        sensor: the dead zone.
        prior: prior at its start.
        weights: weights of the programme's errors.
        stride: samples of an interval.
        rms: rms of the disturbance that is held over a node's samples (m) [u]: it moves the state
            as far as white noise does.
        doubt: of readings (None: no doubt).
        tangents: the model's straight lines.
        solve: solver of the programme (None: not built yet).
    """

    model: System
    sensor: Zone
    prior: JointPrior
    weights: HorizonWeights
    stride: int
    rms: Floats
    doubt: Doubt | None
    tangents: Tangents
    solve: horizon.Solver | None = None


def build_moving_horizon(setup: HorizonSetup, nodes: int, plugin: str) -> Observer:
    """Build the estimator.

    Its covariance, which weighs the past and is shown, is that of a Kalman filter on the active
    readings: what silence adds is not counted.

    Args:
        setup: its fixed parts.
        nodes: intervals of the horizon.
        plugin: CasADi's name of the solver.
    """
    start = initial_horizon_state(setup, nodes)
    solve = horizon.build_qp_solver(plugin, *horizon.programme_size(start.window))
    setup = setup._replace(solve=solve)
    how = PythonObserver(
        lambda seed: start, partial(correct_horizon, setup), partial(predict_horizon, setup)
    )
    return build_python_observer(how, setup.model.p, Traits())


def initial_horizon_state(setup: HorizonSetup, nodes: int) -> HorizonState:
    """Return the state at t = 0: every node of the window contains the prior alone."""
    prior = setup.prior.prior
    mean = prior.mean
    cov = np.diag(prior.std**2)
    none = np.zeros(setup.model.p)
    still = no_motion(setup.model)
    output = setup.tangents.output(mean[: setup.model.n])
    padding = Window(none, none, none, mean, cov, *output, *still)
    window = Window(*(np.repeat(part[None], nodes + 1, axis=0) for part in padding))
    return HorizonState(window, mean, cov, *still, 0, none)


def no_motion(model: System) -> tuple[Floats, Floats, Floats]:
    """Return F (n x n), f (n) and G (n x m) of a node at the same time."""
    return np.eye(model.n), np.zeros(model.n), np.zeros((model.n, model.m))


def correct_horizon(
    setup: HorizonSetup, s: HorizonState, reading: Reading
) -> tuple[HorizonState, Estimate]:
    """Return the state and the estimate given a reading.

    Every `stride` samples a node is added.

    A reading that is likelier a glitch counts as missing. If most recent ones did, or the state
    left all bounds, the filter is restarted from the prior.
    """
    n = setup.model.n
    p = setup.model.p
    if (s.share > TOO_MANY).any() or not (np.abs(s.X) < LIMIT).all():
        s = initial_horizon_state(setup, len(s.window.y) - 1)
    seen = np.isfinite(reading.y)
    side = np.where(seen, reading.side, 0.0)
    C, offset = setup.tangents.output(s.X[:n])
    rows = np.stack([horizon.reading_row(C, i, side[i]) for i in range(p)])
    y = np.where(seen, reading.y / setup.sensor.slope, 0.0)
    e = np.where(np.abs(side) == 1, y - rows @ s.X - offset, 0.0)
    e_std = np.sqrt(horizon.row_variances(rows, s.cov) + setup.prior.prior.R)
    if setup.doubt is not None:
        refused = (np.abs(side) == 1) & (glitch_probability(setup.doubt, e, e_std) > 0.5)
        e = np.clip(e, -CLIP * e_std, CLIP * e_std)
        side = np.where(refused, 0.0, side)
        seen = seen & ~refused
        s = s._replace(share=update_rejection_share(setup.doubt, s.share, side, refused))
    if s.since % setup.stride == 0:
        s = add_horizon_node(setup, s, y, side, seen)
    C, offset = setup.tangents.output(s.X[:n])
    sums = np.hstack([np.zeros((p, n)), np.eye(p), np.eye(p)])
    width_std = np.sqrt(horizon.row_variances(sums, s.cov))
    std = np.sqrt(np.maximum(np.diag(s.cov), 0.0))
    z = C @ s.X[:n] + offset
    return s, numeric_estimate(s.X, z, reading, setup.sensor, e, std, width_std, e_std)


def add_horizon_node(
    setup: HorizonSetup, s: HorizonState, y: Floats, side: Floats, seen: Floats
) -> HorizonState:
    """Add a node to the state and solve the programme.

    Args:
        setup: the estimator.
        s: the state before the reading.
        y: reading y / m, 0 if it is missing (p).
        side: measured side, 0 if the reading is missing (p).
        seen: whether there was a reading (p).
    """
    n = setup.model.n
    cov = covariance_at_sample(setup, s)
    C, offset = setup.tangents.output(s.X[:n])
    F, f, G = no_motion(setup.model)
    unknown = 0 * F, f, G  # the motion on from this node
    newest = Window(y, side, 1.0 * seen, s.X, cov, C, offset, *unknown)
    window = shift_window(s, newest)
    assert setup.solve is not None
    X = horizon.solve_horizon(window, setup.weights, setup.solve)
    for i in range(setup.model.p):
        if abs(side[i]) == 1:
            cov = horizon.covariance_after_reading(
                cov, horizon.reading_row(C, i, side[i]), setup.prior.prior.R[i]
            )
    return HorizonState(window, s.X if X is None else X, cov, F, f, G, 0, s.share)


def update_rejection_share(doubt: Doubt, share: Floats, side: Floats, refused: Any) -> Floats:
    """Return the mean share of rejected readings after one more on some outputs (p) [1]."""
    mean = doubt.forget * share + (1 - doubt.forget) * refused
    return np.where(refused | (side != 0), mean, share)


def covariance_at_sample(setup: HorizonSetup, s: HorizonState) -> Floats:
    """Return the covariance of X at this sample (n + 2p x n + 2p) from the newest node's."""
    n = setup.model.n
    p = setup.model.p
    T = np.eye(n + 2 * p)
    T[:n, :n] = s.F
    drift = np.concatenate([np.zeros(n), s.since * setup.prior.prior.drift])
    cov: Floats = T @ s.cov @ T.T + np.diag(drift)
    cov[:n, :n] += s.G @ s.G.T
    return cov


def shift_window(s: HorizonState, newest: Window) -> Window:
    """Return the window with a new node and without its oldest.

    The motion up to the new node is known.
    """
    motion = {}
    for name in ("F", "f", "G"):
        before = getattr(s.window, name)[:-1]
        motion[name] = np.concatenate([before, getattr(s, name)[None]])
    parts = []
    for old, new in zip(s.window._replace(**motion), newest, strict=True):
        parts.append(np.concatenate([old[1:], new[None]]))
    return Window(*parts)


def predict_horizon(setup: HorizonSetup, s: HorizonState, u: Floats) -> HorizonState:
    """Return the state at the next sample."""
    n = setup.model.n
    x, A, B = setup.tangents.move(s.X[:n], u)
    return s._replace(
        X=np.concatenate([x, s.X[n:]]),
        F=A @ s.F,
        f=A @ s.f + x - A @ s.X[:n],
        G=A @ s.G + B * setup.rms,
        since=s.since + 1,
    )
