"""Likelihood of a reading, by one step of a filter that many lanes share.

The filter is an extended Kalman filter of [x; a], where a is the disturbance at the inputs. Widths,
noises and numbers of the plant are numbers of a lane and no states, so that no transient of an
estimate counts as certain. The density of a reading is a sum over the pieces of the characteristic:
right, silent and left. Each piece is exact but for the linearisation, silence included. What is
left of z is matched in mean and variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.nonlinearities.actuator import Drive, through_zone, within_limits
from undeadzone.nonlinearities.sensor import present
from undeadzone.numerics.gaussian import (
    Gaussian,
    from_upper_entries,
    linearise,
    normal_cdf,
    normal_density,
    predict_first_order,
    to_upper_entries,
)
from undeadzone.plants.system import System
from undeadzone.util import tree

WRONG = 1e-9  # share of readings that mean nothing
LEAST_AFTER = 0.02  # noise after the zone, at least, in noise ahead of it
OPEN = 8.0  # a cut that cuts nothing
DEEPEST = -5.0  # cut that is followed
LEAST = 1e-290  # chance of a piece, at least
STEEPEST = 40.0  # deviations by which a cut moves a mean, at most
RECORDED = 3  # numbers of a reading: log of its density, its prediction, log of the deviation


class FilterNumbers(NamedTuple):
    """Numbers of a lane.

    Attributes:
        plant: numbers of the plant.
        right, left: widths d_r, d_l (p) [z].
        slope: of the sensor (p) [y/z].
        before, after: noise ahead of the zone (p) [z] and behind it (p) [y].
        rms, correlation_time: of the disturbance (m) [u], (1) [s].
        drive: actuator ahead of the plant (None: there is none).
        compliance: deviation of a flank's place in a sample from its law (1) [rad].
        heat_before, heat_rms: further noise ahead of the zone (p) [z] and further disturbance
            (m) [u], which make the likelihood of a wrong plant smooth.
    """

    plant: Any
    right: Any
    left: Any
    slope: Any
    before: Any
    after: Any
    rms: Any
    correlation_time: Any
    drive: Drive | None
    compliance: Any
    heat_before: Any
    heat_rms: Any


class Piece(NamedTuple):
    """Piece of a characteristic: the reading is gain z + offset if low < z < high.

    Attributes:
        gain, offset: of the reading.
        low, high: ends of the piece [z] (None: infinite).
    """

    gain: Any
    offset: Any
    low: Any
    high: Any


class Share(NamedTuple):
    """Share of a piece in the density of a reading, with the moments of z in it.

    Attributes:
        weight: density of the reading times the chance of the piece.
        mean, square: first and second moment of z.
    """

    weight: Any
    mean: Any
    square: Any


def list_pieces(kind: str, q: FilterNumbers, i: int) -> list[Piece]:
    """Return the pieces of the characteristic of output i.

    Args:
        kind: "deadzone", "jump", or "plain" without a zone.
        q: numbers of the lane.
        i: number of the output.
    """
    m = q.slope[i]
    if kind == "plain":
        return [Piece(m, 0.0, None, None)]
    right, left = q.right[i], q.left[i]
    over = m * float(kind == "deadzone")
    return [
        Piece(m, -over * right, right, None),
        Piece(0.0, 0.0, -left, right),
        Piece(m, over * left, None, -left),
    ]


def weigh_piece(y: Any, z: Any, variance: Any, noise: Any, piece: Piece) -> Share:
    """Return the share of a piece in the density of a reading.

    Args:
        y: reading.
        z, variance: mean and variance of z before it, ahead of any cut.
        noise: variance of the noise behind the zone.
        piece: the piece.
    """
    S = piece.gain**2 * variance + noise
    e = y - piece.gain * z - piece.offset
    std = ca.sqrt(variance * noise / S)
    middle = z + variance * piece.gain * e / S
    chance, slope, bend = 1.0, 0.0, 0.0
    for end, sign in ((piece.low, -1.0), (piece.high, 1.0)):
        if end is not None:
            alpha = ca.fmin(ca.fmax(sign * (end - middle) / std, -1e6), 1e6)
            chance -= normal_cdf(-alpha)
            slope -= sign * normal_density(alpha)
            bend -= alpha * normal_density(alpha)
    chance = ca.fmax(chance, LEAST)
    shift = ca.fmax(ca.fmin(slope / chance, STEEPEST), -STEEPEST)
    spread = ca.fmin(ca.fmax(1.0 + bend / chance - shift**2, 1e-9), 1.0)
    mean = middle + shift * std
    density = normal_density(e / ca.sqrt(S)) / ca.sqrt(S)
    return Share(chance * density, mean, mean**2 + spread * std**2)


def uncut(z: Any, variance: Any, cuts: Any) -> tuple[Any, Any]:
    """Return mean and variance of the normal distribution of which z has what two cuts leave.

    Args:
        z, variance: mean and variance that are left.
        cuts: distances of the ends from the mean of the whole, right and left, in its deviations.
    """
    for cut, sign in ((cuts[0], 1.0), (cuts[1], -1.0)):
        hazard = normal_density(cut) / normal_cdf(cut)
        left = 1.0 - hazard * (hazard + cut)
        variance = variance / left
        z = z + sign * ca.sqrt(variance) * hazard
    return z, variance


def build_step(model: System, kind: str, like: FilterNumbers) -> ca.Function:
    """Return the filter's step(s, w, p) with s = [x; a; covariance], w = [y; u; side].

    The side of each reading is 1 or -1 if it surely is on an active piece, else 0. Its results are
    the next s and, of each output, `RECORDED` numbers.

    Args:
        model: the sampled plant.
        kind: as of `list_pieces`.
        like: numbers of a lane, for their shapes.
    """
    n, m, p = model.n, model.m, model.p
    entries = ca.Sparsity.upper(n + m)
    column, q = tree.create_symbols(like, "q")
    size = n + m + entries.nnz()
    s = ca.SX.sym("s", size + 2 * p)
    w = ca.SX.sym("w", p + m + p)
    y, u, side = ca.vertsplit(w, [0, p, p + m, p + m + p])
    belief = Gaussian(s[: n + m], from_upper_entries(s[n + m : size], entries))
    outputs = []
    rows = []
    cuts = []

    def read_output(i: int, X: Any) -> Any:
        """Return what the sensor of output i reads, without its zone."""
        return model.read(q.plant, X[:n])[i]

    for i in range(p):
        use = partial(_use_reading, kind, q, belief, ca.vertsplit(s[size + 2 * i :])[:2])
        z, h = linearise(partial(read_output, i), belief.mean)
        fresh = q.before[i] ** 2 + q.heat_before[i] ** 2
        belief, after, recorded = use(z, h, fresh, y[i], side[i], i)
        outputs += recorded
        rows.append((h, fresh))
        cuts.append(after)
    if q.drive is not None:
        u = through_zone(ca, within_limits(ca, u, q.drive), q.drive)
    assert model.Ts is not None
    assert model.change is not None
    motion = model.change
    memory = ca.exp(-model.Ts / q.correlation_time)
    rms = ca.sqrt(q.rms**2 + q.heat_rms**2)

    def change_all(X: Any) -> Any:
        """Return the change of [x; a] in a step."""
        moved = motion(q.plant, X[:n], u + X[n:])
        return ca.vertcat(moved, (memory - 1.0) * X[n:])

    Q = ca.diag(ca.vertcat(ca.SX.zeros(n), rms**2 * (1.0 - memory**2)))
    if model.gears is not None:
        Q[:n, :n] += q.compliance**2 * _spread_contacts(model, q.plant, belief.mean, u)
    following = predict_first_order(belief, change_all, Q)
    ends = []
    for (h, fresh), pair in zip(rows, cuts, strict=True):
        share = (h @ belief.cov @ h.T) / (h @ following.cov @ h.T + fresh)
        opened = 1.0 / ca.fmax(ca.fmin(share, 1.0), 1e-3) - 1.0
        ends += [ca.fmin(cut + opened, OPEN) for cut in pair]
    state = ca.vertcat(following.mean, to_upper_entries(following.cov, entries), *ends)
    return ca.Function("fit", [s, w, column], [state, ca.vertcat(*outputs)], {"cse": True})


def _spread_contacts(model: System, params: Any, X: Any, u: Any) -> Any:
    """Return the covariance of x after a sample in which each half gap is off by 1 (n x n).

    A contact that is off its law moves motor and link against each other, and never both together.
    """
    gears: Any = model.gears
    n = model.n
    change: Any = model.change
    first = gears.names.index("half1")
    places = range(first, first + gears.joint_count)

    def shift(half: Any) -> Any:
        """Return the change of x with other half gaps."""
        shifted = ca.SX(params)
        shifted[places] += half
        return change(shifted, X[:n], u + X[n:])

    _, slope = linearise(shift, ca.SX.zeros(gears.joint_count))
    return slope @ slope.T


def _use_reading(
    kind: str,
    q: FilterNumbers,
    belief: Gaussian,
    cuts: Sequence[Any],
    z: Any,
    h: Any,
    fresh: Any,
    y: Any,
    side: Any,
    i: int,
) -> tuple[Gaussian, list[Any], list[Any]]:
    """Return the belief after the reading of output i, its cuts, and the recorded numbers.

    Args:
        kind, q: as those of `list_pieces`.
        belief: before the reading.
        cuts: of z by silence, as those of `uncut`.
        z, h: prediction of z and its row.
        fresh: variance of the noise ahead of the zone.
        y, side: reading and its sure side.
        i: number of the output.
    """
    along = belief.cov @ h.T
    variance = h @ along + fresh
    noise = ca.fmax(q.after[i], LEAST_AFTER * q.before[i] + 1e-12) ** 2
    deviation = ca.sqrt(q.slope[i] ** 2 * variance + noise)
    pieces = list_pieces(kind, q, i)
    opened = list(cuts)
    if kind == "plain":
        shares = [weigh_piece(y, z, variance, noise, pieces[0])]
    else:
        shares, opened = _weigh_zone(pieces, z, variance, noise, y, side, cuts)
    shares.append(Share(WRONG / deviation, z, z**2 + variance))
    total = sum(each.weight for each in shares)
    mean = sum(each.weight * each.mean for each in shares) / total
    square = sum(each.weight * each.square for each in shares) / total
    left = ca.fmin(ca.fmax((square - mean**2) / variance, 1e-12), 1.0)
    seen = present(y)
    doubt = shares[0].weight * sum(each.weight for each in shares[1:-1]) / total**2
    trust = ca.if_else(seen, (1.0 - 4.0 * doubt) ** 2, 0.0)
    gain = along / variance
    moved = belief.mean + gain * trust * (mean - z)
    cov = belief.cov - gain @ along.T * trust * (1.0 - left)
    offsets = [pieces[0].offset, pieces[-1].offset]
    offset = ca.if_else(side > 0, offsets[0], ca.if_else(side < 0, offsets[1], 0.0))
    prediction = q.slope[i] * z + offset
    density = ca.if_else(seen, ca.log(total), 0.0)
    pairs = zip(opened, cuts, strict=True)
    after = [ca.if_else(seen, one, cut) for one, cut in pairs]
    return Gaussian(moved, cov), after, [density, prediction, ca.log(deviation)]


def _weigh_zone(
    pieces: list[Piece], z: Any, variance: Any, noise: Any, y: Any, side: Any, cuts: Any
) -> tuple[list[Share], list[Any]]:
    """Return the shares of right, silent and left piece, and the cuts after the reading."""
    right, silent, left = pieces
    middle, whole = uncut(z, variance, cuts)
    std = ca.sqrt(whole)
    top, bottom = middle + cuts[0] * std, middle - cuts[1] * std
    sure = side != 0
    inside = Piece(0.0, 0.0, bottom, top)
    before = weigh_piece(y, middle, whole, noise, inside)
    within = Piece(0.0, 0.0, ca.fmax(silent.low, bottom), ca.fmin(silent.high, top))
    after = weigh_piece(y, middle, whole, noise, within)
    chance = ca.fmax(normal_cdf(cuts[0]) - normal_cdf(-cuts[1]), LEAST)
    mean = z + after.mean - before.mean
    lost = (after.square - after.mean**2) / ca.fmax(before.square - before.mean**2, 1e-9 * whole)
    shares = [Share(after.weight / chance, mean, mean**2 + variance * ca.fmin(lost, 1.0))]
    far = 1e3 * std
    beyond = [
        right._replace(low=ca.fmin(right.low, top), high=ca.if_else(sure, middle + far, top)),
        left._replace(low=ca.if_else(sure, middle - far, bottom), high=ca.fmax(left.high, bottom)),
    ]
    for piece in beyond:
        one = weigh_piece(y, middle, whole, noise, piece)
        shares.append(one._replace(weight=one.weight / chance))
    active = (shares[1].weight + shares[2].weight) / sum(each.weight for each in shares)
    edges = [(within.high - middle) / std, (middle - within.low) / std]
    moved = [ca.fmax(edge, DEEPEST) * (1.0 - active) + active * OPEN for edge in edges]
    return shares, moved
