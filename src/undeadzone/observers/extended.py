"""Extended Kalman filter on the measured branch, for nonlinear models of several outputs.

Robot arms are among them (docs/methods/extended.md): their joints are filtered each for itself,
with one covariance of `[q_i; q_i'; d_ri; d_li; a_i]`. The effect of the other joints on a joint is
an unknown acceleration a_i.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Observer
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.observers.filtering.augmented_state import (
    default_disturbance_rms,
    power_of_two_units,
)
from undeadzone.observers.filtering.gaussian_filter import Augmentation, Params
from undeadzone.observers.filtering.measured_kalman import build_branch_filter
from undeadzone.observers.filtering.prior import (
    GLITCHES,
    Prior,
    build_prior,
    outlier_probability,
    prior_traits,
)
from undeadzone.observers.filtering.unknown_inputs import (
    OFFSET,
    Colour,
    build_colour,
    build_unknown_inputs,
    read_named_parameters,
    resolve_correlation_time,
    resolve_input_rms,
)
from undeadzone.plants.system import System, scale_states
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats

LEVELS = 3  # of a disturbance without an assumption


class Extended(Options, frozen=True, kw_only=True, tag="extended"):
    """Kalman filter on the measured branch with the model linearised at the estimate.

    It is linearised in each sample (sampled time only).

    Example:
        >>> uz.Extended(right=[0.0, 2.0], disturbance=0.2, start=[0.1, 0.0]).start
        [0.1, 0.0]

    See Also:
        Auto, Censored

    Attributes:
        right, left: assumed ranges [lo, hi] of d_r and d_l, one or one per output [z] (left
            defaults to that of right).
        centre: assumed range [lo, hi] of (d_r - d_l)/2, a number if it is known (0: a symmetric
            zone), or one range per output [z] (default: the range that follows from those of d_r
            and d_l).
        noise: least rms of a reading on an active side, one or one per output [z] (default the
            sensor's): a larger one is learnt from the readings.
        start: mean of x(0), one or one per state (with a small x_std, the position after homing).
        x_std: standard deviation of x(0), one or one per state (default the deviation that appears
            in z as five times the largest width).
        disturbance: rms of an unknown input, one or one per input [u], default the rms that moves z
            by half of the largest width in a quarter period (the value 0 is an assumption as well).
        bias: rms of an unknown constant input, one or one per input [u] (default a quarter of the
            disturbance's default if none is assumed, else none).
        levels: number of disturbance levels (rms) that are weighted by their likelihood (1 to 10),
            as in `censored` (default 3 if none is assumed, else 1, and 1 for separate joints).
        correlation_time: correlation time of the disturbance, first-order noise [s] (default a 16th
            of the plant's period, 12.5 samples if it only integrates).
        drift: random walk of the widths [z / sqrt(s)] (default 0).
        glitches: probability that a reading is wrong, for any sensor (0 trusts all readings, as
            textbooks do, and shows no wider intervals if they do not fit). A blind filter trusts
            all readings.
        uncertain: standard deviations of named parameters of the model, which become constant
            unknowns.
        silence: use that a censored sample bounds z, and that widths lie in their ranges.
        blind: take every reading for z, as if there were no dead zone.
        joints: "separate" keeps one covariance per joint of an arm `[q; q']` whose positions are
            measured, to which the disturbance is an acceleration, as is the effect of the other
            joints: much cheaper, with weaker assumptions.
    """

    right: Array
    left: Array | None = None
    centre: Array | None = None
    noise: Array | None = None
    start: Array = 0.0
    x_std: Array | None = None
    disturbance: Array | None = None
    bias: Array | None = None
    levels: int | None = None
    correlation_time: float | None = None
    drift: float = 0.0
    glitches: float = GLITCHES
    uncertain: dict[str, float] = {}
    silence: bool = True
    blind: bool = False
    joints: Literal["coupled", "separate"] = "coupled"

    def build(self, model: System, sensor: Zone) -> Observer:
        """Return the filter for a sampled model. Raises InputError, ShapeError."""
        if sensor.kind == "jump" and not (self.silence or self.blind):
            raise InputError(
                "observer.silence: readings of a jump sensor only bound its widths, so that "
                "no information on them remains without silence"
            )
        prior = self._filter_prior(model, sensor)
        Ts = model.Ts
        assert Ts is not None
        correlation = resolve_correlation_time(self.correlation_time, model.continuous, Ts)
        usual = default_disturbance_rms(model, prior.ranges.max(), correlation)
        rms = resolve_input_rms("disturbance", self.disturbance, usual)
        doubts = self.disturbance is None and self.joints == "coupled" and not self.blind
        bias = resolve_input_rms("bias", self.bias, OFFSET * usual * doubts)
        # Joints that are filtered each for itself need [q; q'] as it is.
        units = np.ones(model.n) if self.joints == "separate" else power_of_two_units(model)
        colour = build_colour(correlation, Ts)
        default = LEVELS if doubts else 1
        traits = prior_traits(prior, self.x_std)
        return build_branch_filter(
            model,
            units,
            sensor,
            prior,
            self._build_augmentation(scale_states(model, units), colour, rms, bias),
            outlier_probability(self.glitches),
            traits._replace(adapts=not self.blind, uncertain=tuple(self.uncertain)),
            lasting=max(1.0, correlation / Ts),
            bounds=self.silence and not self.blind,
            order=1,
            blind=self.blind,
            is_assumed=self.disturbance is not None,
            careful=self.x_std is None or self.disturbance is None,
            levels=default if self.levels is None else self.levels,
            learns_shape=self.joints == "coupled",
        )

    def _filter_prior(self, model: System, sensor: Zone) -> Prior:
        """Return the prior, with widths of 0 for a blind filter.

        Raises InputError, ShapeError.
        """
        prior = build_prior(
            self, model, sensor, start=self.start, centre=self.centre, silence=self.silence
        )
        if not self.blind:
            return prior
        n = model.n
        none = np.zeros(2 * model.p)
        mean = np.append(prior.mean[:n], none)
        std = np.append(prior.std[:n], none)
        return prior._replace(mean=mean, std=std, drift=none, asymmetry=None)

    def _build_augmentation(
        self, model: System, colour: Colour, rms: Floats, bias: Floats
    ) -> Augmentation:
        """Return the model of all unknowns beside `[x; d]`: disturbance, bias, parameters.

        Args:
            model: the sampled model, in the filter's units.
            colour: first-order model of the disturbance.
            rms: rms of the disturbance (m) [u].
            bias: prior standard deviation of a constant input disturbance (m) [u].

        Raises:
            InputError: separate joints with an uncertain parameter or a bias.
        """
        if self.joints == "separate":
            if self.uncertain or bias.any():
                key = "uncertain: a parameter" if self.uncertain else "bias: a constant"
                raise InputError(
                    f'observer.{key} binds the joints together. Take joints = "coupled"'
                )
            return build_separate_joints(model, colour, rms)
        augmentation = build_unknown_inputs(
            model, colour, rms, bias, 0.0, read_named_parameters(model, self.uncertain)
        )
        places = tuple(map(model.names.index, self.uncertain))
        return augmentation._replace(parameters=places)


class Noise(NamedTuple):
    """Noise of the joints' accelerations a+ = F a + noise of covariance Q variance (N)."""

    F: Any
    Q: Any
    variance: Floats


class Joints(NamedTuple):
    """Options shared by the functions of `build_separate_joints`.

    Attributes:
        rate: rate(params, x, u) is x' of the arm.
        size: number N of joints.
        Ts: sample time [s].
    """

    rate: Callable[[Any, Any, Any], Any]
    size: int
    Ts: float


def build_separate_joints(model: System, colour: Colour, rms: Floats) -> Augmentation:
    """Return the augmentation by an unknown acceleration of each joint.

    Each joint has a covariance of its own five unknowns.

    The mean moves by the whole model, whose accelerations are taken once a sample. The variance is
    that of the accelerations that the disturbance makes at the point of linearisation.

    Args:
        model: the sampled model of an arm.
        colour: the disturbance of unit rms.
        rms: rms of the disturbance (m) [u].

    Raises:
        InputError: for a model that is not `[q; q']` with q measured, and for a joint without
            disturbance.
    """
    N = model.p
    Ts = model.Ts
    rate = model.rate
    flow = model.flow
    if rate is None or flow is None or Ts is None or not is_mechanical(model):
        raise InputError(
            "observer.joints: separate joints need a nonlinear model of states [q; q'] that "
            "measures each position, such as a rigid arm's"
        )
    variance = flow.B[N:] ** 2 @ rms**2
    if not variance.all():
        raise InputError(
            "observer.disturbance: must be positive for separate joints: it stands for the effect "
            "of the other joints"
        )
    joints = Joints(rate, N, Ts)
    return Augmentation(
        Noise(colour.F[0, 0], colour.Q[0, 0], variance),
        np.diag(variance),
        partial(joint_change, joints),
        partial(joint_noise, joints),
        slope=partial(joint_slope, joints),
        disturbance=partial(joint_disturbance, joints),
        entries=ca.triu(ca.kron(ca.DM.ones(5, 5), ca.DM.eye(N))).sparsity(),
    )


def joint_change(joints: Joints, q: Params, x: Any, extra: Any, u: Any) -> tuple[Any, Any]:
    """Return (x+ - x, a+ - a) with accelerations constant over the step."""
    N = joints.size
    Ts = joints.Ts
    v = x[N:]
    a = joints.rate(q.model, x, u)[N:] + extra
    return ca.vertcat(Ts * v + Ts**2 / 2 * a, Ts * a), (q.augmentation.F - 1) * extra


def joint_slope(joints: Joints, q: Params) -> Any:
    """Return the Jacobian of the change (5N x 5N): for each joint a double integrator under a."""
    Ts = joints.Ts
    one = ca.SX(5, 5)  # of [q_i; q_i'; d_ri; d_li; a_i]
    one[0, 1] = Ts
    one[0, 4] = Ts**2 / 2
    one[1, 4] = Ts
    one[4, 4] = q.augmentation.F - 1
    return ca.kron(one, ca.SX.eye(joints.size))


def joint_noise(joints: Joints, q: Params, x: Any, u: Any) -> tuple[Any, Any]:
    """Return the covariances that a step adds to x and to the accelerations."""
    states = 2 * joints.size
    return ca.SX(states, states), q.augmentation.Q * ca.diag(q.augmentation.variance)


def joint_disturbance(joints: Joints, q: Params, extra: Any) -> Any:
    """Return the accelerations' contribution to x' (2N)."""
    return ca.vertcat(ca.SX.zeros(joints.size), extra)


def is_mechanical(model: System) -> bool:
    """Return whether the states are `[q; q']` and the outputs q, up to a constant."""
    N = model.p
    if model.n != 2 * N or model.flow is None:
        return False
    A, B, C = model.flow
    measures_positions = (np.eye(N, 2 * N) == C).all()
    integrates_speeds = (np.eye(N, 2 * N, N) == A[:N]).all() and not B[:N].any()
    return bool(measures_positions and integrates_speeds)
