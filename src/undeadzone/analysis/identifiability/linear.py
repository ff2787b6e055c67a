"""Identifiability of x, d_r, d_l along a schedule of branches, and remedies.

Proofs are in docs/identifiability.md. The unknowns are `[x(0); d; beta]`, d = [right, left] per
output, beta a constant input bias. What stays unknown is a subspace, kept as an orthonormal basis.

Edges of the dead zone that a schedule does not reach: why not, and what would reach them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import compress, filterfalse
from typing import Any, NamedTuple

import numpy as np

from undeadzone.analysis.branch_schedule import Schedule
from undeadzone.analysis.error_dynamics import branch_pattern
from undeadzone.linalg.matrices import Matrices, delta_form, state_response_sizes
from undeadzone.nonlinearities.sensor import DIRECTIONS, heaviest
from undeadzone.util.arrays import Floats

RARE = 0.1  # share of exact readings beyond the edges, below which a verdict reports it
MARGIN = 0.05  # by which a cure passes an edge, relative to the edge
NEGLIGIBLE = 1e-6  # share of the motion's range: a smaller deviation is known, also of width 0


class Remedy(NamedTuple):
    """Smallest change of the reference that makes an output reach its edges.

    Attributes:
        output: which output.
        factor: by which its deviation from its mean grows (None if that is not the cure).
        shift: offset that is added to it (None if that is not the cure).
        text: the cure in words (alone if no reference helps).
    """

    output: int
    factor: float | None
    shift: float | None
    text: str


def describe_unreached_edges(schedule: Schedule, visited: np.ndarray, i: int) -> list[str]:
    """Describe why edges of output i are not visited, empty if all are.

    Args:
        schedule: of the sides.
        visited: whether each [right, left] side is visited (p x 2).
        i: the output.
    """
    right, left = schedule.levels[i]
    high = schedule.high[i]
    low = schedule.low[i]
    reasons = []
    gaps = ("", "") if schedule.contacts is None else (" + c_r", " - c_l")
    edges = (
        (1.0, "right", f"d_r{gaps[0]}", "below", high, right),
        (-1.0, "left", f"-d_l{gaps[1]}", "above", low, -left),
    )
    for (sign, name, edge, side, end, level), is_visited in zip(edges, visited[i], strict=True):
        if is_visited:
            continue
        why = f"hardly reached: too few readings arrive from beyond {edge} to separate it from "
        why += "the state"
        if sign * (end - level) <= 0:
            why = f"never reached: the output stays {side} {edge}, {end:.4g} against {level:.4g}"
        reasons.append(f"the {name} edge is {why}")
    return reasons


def describe_rare_exactness(schedule: Schedule, i: int) -> list[str]:
    """Describe that most readings of output i beyond its edges are at a limit of the range."""
    share = 1.0 if schedule.exact is None else float(schedule.exact[i])
    if share >= RARE:
        return []
    if share == 0:
        return ["no reading beyond the edges is exact: all are at a limit of sensor.range"]
    return [
        f"only {100 * share:.2g} % of the readings beyond the edges are exact: the others are at "
        f"a limit of sensor.range, and only bound z"
    ]


def limit_to_deviations(
    verdict: WidthIdentifiability, std: dict[str, float], right: float, left: float, swing: float
) -> WidthIdentifiability:
    """Return the verdict with the deviations of the widths, unknown if smaller than those.

    Of the centre the largest deviation is half of the width.

    Args:
        verdict: on an output, by its readings alone.
        std: expected deviations by name [z].
        right, left: widths of the output [z].
        swing: of the output, used if the widths are 0 [z].
    """
    sizes = {"right": right, "left": left, "width": right + left, "centre": right + left}
    known: dict[str, Any] = {}
    larger = []
    for name, size in sizes.items():
        most = heaviest(DIRECTIONS[name]) * max(float(size) or swing, NEGLIGIBLE * swing)
        known[name] = getattr(verdict, name) and std[name] <= most
        if most < std[name] < np.inf:
            larger.append(f"{name} {std[name]:.3g}")
    vague = (
        "practically not: noise and disturbances leave larger deviations than the widths "
        f"({right:.3g}, {left:.3g}) to {', '.join(larger)}"
    )
    return verdict.add_reasons(*[vague] * bool(larger), **known)._replace(std=std)


def remedy_to_reach_edges(schedule: Schedule, i: int) -> Remedy:
    """Return the smallest change of output i that reaches both of its edges, with a margin."""
    right, left = schedule.levels[i] * (1 + MARGIN)
    low = schedule.low[i]
    mean = schedule.mean[i]
    high = schedule.high[i]
    mean = 0.0 if abs(mean) <= 1e-9 * (high - low) else mean
    if high - low <= 1e-9 * max(abs(high), abs(low), right, left):
        swing = max(right - mean, mean + left)
        text = f"let output {i} move: a swing of {swing:.4g} about {mean:.4g} reaches both edges"
        return Remedy(i, None, None, text)
    factor = max((right - mean) / (high - mean), (mean + left) / (mean - low), 1.0)
    shift = max(right - high, 0.0) - max(low + left, 0.0)
    by_factor = (factor - 1) * max(high - mean, mean - low)  # how far the factor moves the output
    if high - low >= right + left and abs(shift) < by_factor * (1 - 1e-9):
        return Remedy(
            i, None, shift, f"shift output {i} by {shift:.4g}: it then reaches both edges"
        )
    text = (
        f"make the swing of output {i} about its mean, {mean:.4g}, {factor:.4g} times as large: "
        "it then reaches both edges"
    )
    return Remedy(i, factor, None, text)


# --- Information in the readings

# Of singular values of balanced, normalised matrices; a sampled model's rounding comes on top.
TOLERANCE = 1e-11
PRESENT = 1e-7  # see `Invisible`


class Unobservable(NamedTuple):
    """Changes of the unknowns that do not change any reading.

    Attributes:
        basis: orthonormal columns (n + 2p + b, k), the changes are these times `scale` by rows.
        scale: units of the unknowns (n + 2p + b).
        n: how many states come first.
        present: least component of a unit vector that counts.
    """

    basis: Floats
    scale: Floats
    n: int
    present: float = PRESENT

    def is_state_known(self, i: int) -> bool:
        """Return whether state i is determined nevertheless."""
        return not bool((np.abs(self.basis[i]) > self.present).any())

    def is_pair_known(self, pairs: Mapping[int, Sequence[float]]) -> bool:
        """Return whether a combination of pairs of unknowns is determined nevertheless.

        Args:
            pairs: weights of two neighbours among the unknowns, by the place of the first.
        """
        direction = np.zeros(self.scale.size)
        for first, weights in pairs.items():
            direction[first : first + 2] = weights
        direction *= self.scale
        change = (direction / np.abs(direction).max()) @ self.basis
        return not bool((np.abs(change) > self.present).any())

    def is_width_known(self, i: int, name: str) -> bool:
        """Return whether a width of output i is determined nevertheless.

        Args:
            i: the output.
            name: `right`, `left`, `width` = d_r + d_l or `centre` = (d_r - d_l)/2.
        """
        return self.is_pair_known({self.n + 2 * i: DIRECTIONS[name]})

    def pair_flags(self, first: int) -> dict[str, Any]:
        """Return whether right, left, width, centre of a pair from `first` on are determined
        nevertheless.
        """
        return {name: self.is_pair_known({first: pair}) for name, pair in DIRECTIONS.items()}

    def width_flags(self, i: int) -> dict[str, Any]:
        """Return whether right, left, width, centre of output i are determined
        nevertheless.
        """
        return self.pair_flags(self.n + 2 * i)

    def std_of_widths(self, i: int, covariance: Floats) -> dict[str, float]:
        """Return the deviations of right, left, width, centre of output i, or inf if undetermined.

        Args:
            i: the output.
            covariance: of the unknowns (n + 2p + b square).
        """
        own = slice(self.n + 2 * i, self.n + 2 * i + 2)
        std = {}
        pair = covariance[own, own]
        for name, direction in DIRECTIONS.items():
            g = np.array(direction)
            std[name] = float(np.sqrt(g @ pair @ g)) if self.is_width_known(i, name) else np.inf
        return std

    def restrict_to_part(self, part: np.ndarray) -> Unobservable:
        """Return the changes that leave every unknown outside `part` (bool) as is."""
        return self._replace(basis=self.basis @ null_space_basis(self.basis[~part], self.present))

    def exclude_known(self, rows: Floats) -> Unobservable:
        """Return the changes that remain invisible if combinations of `[x(0); d]` are known.

        Args:
            rows: weights of each known combination (k x n + 2p); a change v remains if rows v = 0.
        """
        part = self.scale[: rows.shape[1], None] * self.basis[: rows.shape[1]]
        size = np.linalg.norm(rows * self.scale[: rows.shape[1]], axis=1, keepdims=True)
        return self._replace(basis=self.basis @ null_space_basis(rows @ part / size, self.present))

    @property
    def names_of_undetermined(self) -> tuple[str, ...]:
        """Return the names of the undetermined states and widths."""
        outputs = range((self.scale.size - self.n) // 2)
        names = [f"x[{i}]" for i in range(self.n) if not self.is_state_known(i)]
        for i in outputs:
            lost = [name for name in DIRECTIONS if not self.is_width_known(i, name)]
            if lost and "width" not in lost:
                lost = ["centre"]
            else:
                lost = [name for name in lost if name in ("right", "left")]
            names += [f"{name}[{i}]" for name in lost]
        return tuple(names)


class WidthIdentifiability(NamedTuple):
    """Identifiability of the widths of an output.

    Attributes:
        right, left: d_r, d_l.
        width, centre: d_r + d_l, (d_r - d_l)/2.
        reasons: why not, for each 'no', in words.
        std: the deviation that an optimal estimator reaches of each, by name, where noise is taken
            into account.
        second: another truth with these readings (`indistinguishable_widths`).
            None: none far from it, or not looked for.
        crossings: of a gap of gears, strikes that show in the readings; None without gears.
        narrowed: whether an uncertain gap has a narrower range than the declared one.
    """

    right: bool
    left: bool
    width: bool
    centre: bool
    reasons: tuple[str, ...]
    std: dict[str, float] | None = None
    second: dict[str, Any] | None = None
    crossings: int | None = None
    narrowed: bool = False

    def add_reasons(self, *reasons: str, **changed: bool) -> WidthIdentifiability:
        """Return the result with more reasons and with changed fields."""
        changes: dict[str, Any] = {**changed, "reasons": (*self.reasons, *reasons)}
        return self._replace(**changes)


def unobservable_changes(
    linear: Matrices,
    visited: np.ndarray,
    Ts: float | None = None,
    bias: Floats | None = None,
    jump: bool = False,
    drives: Sequence[Floats] | None = None,
    repeats: int = 1,
) -> Unobservable:
    """Return the changes of `[x(0); d; beta]` that do not change any reading.

    They solve A x + B_b beta in U, C_i x = d_ri and C_i x = -d_li on the visited sides, with U the
    subspace that the visited outputs do not observe: time and duration of a visit make no
    difference.

    Args:
        linear: A, B, C of the plant, of one step if sampled.
        visited: whether each [right, left] side is visited (p x 2, bool).
        Ts: sample time [s] (None in continuous time).
        bias: B_b (n x b), like B the directions of unknown constant inputs (of one step if
            sampled).
        jump: whether the sensor jumps (its readings do not contain d).
        drives: in place of `bias`, how beta enters x' (n x b each) in the modes that are visited.
        repeats: how often each output stands in turn, its widths the same.
    """
    A, _, C = delta_form(linear, Ts)
    n = A.shape[0]
    p = C.shape[0]
    constant = np.zeros((n, 0)) if bias is None else bias
    B = np.stack([constant] if drives is None else drives) / (Ts or 1.0)
    # Units in which states, then rates, outputs and inputs, are of order 1.
    state = 1 / state_response_sizes(A.T, C.T)
    A = A / state[:, None] * state
    C = C * state
    B = B / state[:, None]
    rounding = 0.0 if Ts is None else 1e3 * np.finfo(float).eps / Ts
    rate = max(float(np.linalg.norm(A, 2)), 1e6 * rounding, 1e-300)
    output = np.linalg.norm(C, axis=1)
    drive = np.maximum(np.linalg.norm(B, axis=1).max(axis=0), 1e-300)
    A = A / rate
    C = C / output[:, None]
    B = B / drive
    tolerance = TOLERANCE + rounding / rate
    U = unobservable_subspace(A, C[visited.any(axis=1)], tolerance)
    beyond = np.eye(n) - U @ U.T
    shared = share_widths(p, repeats)
    widths = shared.shape[1]
    rows = [np.hstack([beyond @ A, np.zeros((n, widths)), beyond @ mode]) for mode in B]
    for sides in (visited[:, 0] * 1, visited[:, 1] * -1):
        S = (not jump) * branch_pattern(tuple(sides)) @ shared
        rows.append(np.hstack([C * np.abs(sides)[:, None], -S, np.zeros((p, B.shape[2]))]))
    basis = null_space_basis(np.vstack(rows), tolerance)
    return Unobservable(
        basis, np.concatenate([state, np.repeat(output[::repeats], 2), rate / drive]), n
    )


def share_widths(rows: int, repeats: int) -> Floats:
    """Return the matrix (2 rows x 2p) from the widths of p outputs to those of every row.

    Args:
        rows: readings, `repeats` of each output in turn.
        repeats: their number.
    """
    return np.kron(np.eye(rows // repeats), np.tile(np.eye(2), (repeats, 1)))


def unobservable_along(
    linear: Matrices,
    schedule: Schedule,
    bias: Floats | None = None,
    jump: bool = False,
    prior: Floats | None = None,
) -> Unobservable:
    """Return the changes of `[x(0); d; beta]` that no reading along a schedule shows.

    Args:
        linear: A, B, C of the plant, of one step if sampled.
        schedule: of the sides.
        bias: directions (n x b) of unknown constant inputs.
        jump: whether the sensor jumps.
        prior: prior information (`prior_rows`).
    """
    visited = schedule.branch_visits(linear.A.shape[0])
    repeats = schedule.repeats
    hidden = unobservable_changes(
        linear,
        visited,
        schedule.Ts,
        bias,
        jump,
        repeats=repeats,
    )
    return hidden if prior is None else hidden.exclude_known(prior)


def width_identifiability(
    linear: Matrices, schedule: Schedule, bias: Floats | None = None, jump: bool = False
) -> list[WidthIdentifiability]:
    """Return the identifiability of each output's widths from readings along a schedule.

    Args:
        linear, schedule, bias, jump: as of `unobservable_along`.
    """
    visited = schedule.branch_visits(linear.A.shape[0])
    judged = judge_widths(
        unobservable_along(linear, schedule, bias),
        schedule,
        visited,
        not jump,
    )
    if not jump:
        return judged
    flags = map(_flags_of_passed_edges, visited)
    return [one._replace(**known) for one, known in zip(judged, flags, strict=True)]


def judge_widths(
    hidden: Unobservable, schedule: Schedule, visited: np.ndarray, explains: bool = True
) -> list[WidthIdentifiability]:
    """Return the identifiability of each output's widths.

    Args:
        hidden: changes that no reading shows.
        schedule: of the sides.
        visited: whether each [right, left] side is visited (p x 2).
        explains: whether reasons say what hides widths whose sides are visited.
    """
    judged = []
    for i in range(len(visited)):
        confounded = _confounding_reasons(hidden, visited, i) if explains else {}
        reasons = (
            *describe_unreached_edges(schedule, visited, i),
            *confounded,
            *describe_rare_exactness(schedule, i),
        )
        judged.append(WidthIdentifiability(**hidden.width_flags(i), reasons=reasons))
    return judged


def _flags_of_passed_edges(passed: np.ndarray) -> dict[str, Any]:
    """Return which of `DIRECTIONS` a jump sensor knows: those whose edges it passed."""
    right, left = passed.tolist()
    both = right and left
    return dict(zip(DIRECTIONS, (right, left, both, both), strict=True))


def find_remedies(
    linear: Matrices, schedule: Schedule, bias: Floats | None = None, jump: bool = False
) -> list[Remedy]:
    """Return the remedies that make the unidentifiable widths identifiable.

    Args:
        linear: A, B, C of the plant, of one step if sampled.
        schedule: of the sides.
        bias: directions (n x b) of unknown constant inputs.
        jump: whether the sensor jumps.
    """
    visited = schedule.branch_visits(linear.A.shape[0])
    hidden = unobservable_along(linear, schedule, bias)
    changes = []
    for i in range(visited.shape[0]):
        if not visited[i].all():
            changes.append(remedy_to_reach_edges(schedule, i))
        if jump:
            continue
        for remedy in _confounding_reasons(hidden, visited, i).values():
            text = (
                f"no reference can: {remedy}, or add a sensor without a dead zone; "
                "or claim the centre (d_r - d_l)/2 of a filter: observer.centre = [lo, hi], 0 if "
                "the zone is symmetric"
            )
            changes.append(Remedy(i, None, None, text))
    return changes


def _confounding_reasons(hidden: Unobservable, visited: np.ndarray, i: int) -> dict[str, str]:
    """Return {reason: remedy} for widths of output i unknown although their branches are
    visited.
    """
    of_bias = np.arange(hidden.scale.size) >= hidden.n + visited.size

    def describe_shift(edge: str, quantity: str, rest: str) -> str:
        """Describe why a shift of the state hides an edge."""
        return f"A is singular (an integrator), {rest}"

    found = confounding_reason(hidden, visited[i], i, {BIAS: of_bias}, describe_shift)
    if not found:
        return {}
    by_bias = "bias cannot be separated" in found
    return {found: "calibrate the input" if by_bias else "let the plant pass a place of known z"}


BIAS = "constant input bias, {quantity} and bias cannot be separated"


def confounding_reason(
    hidden: Unobservable,
    visited: np.ndarray,
    i: int,
    causes: Mapping[str, np.ndarray],
    describe_shift: Callable[[str, str, str], str],
) -> str:
    """Describe why widths of output i stay unknown although their branches are visited.

    Args:
        hidden: changes that no reading shows.
        visited: whether the right and the left side of the output are.
        i: the output.
        causes: unknowns (bool) that would make its edges known if they were known, by the words for
            this, with the name {quantity}.
        describe_shift: what is the reason if none of these is, of an edge that is not identifiable,
            the name of what is not, and a phrase on what is nevertheless.

    Returns:
        The reason, empty if the widths are known.
    """
    edges = list(compress(("right", "left"), visited))
    unknown = list(filterfalse(partial(hidden.is_width_known, i), edges))
    if not unknown:
        return ""
    is_width_known = len(edges) == 2 and hidden.is_width_known(i, "width")
    quantity = "centre" if is_width_known else " and ".join(f"{name} edge" for name in unknown)
    subject = "centre" if is_width_known or len(edges) == 1 else "width"
    start = f"the {subject} is not identifiable: "
    for words, part in causes.items():
        rest = hidden.restrict_to_part(~part)
        if part.any() and all(map(partial(rest.is_width_known, i), edges)):
            return start + words.format(quantity=quantity)
    remainder = f"the {quantity} cannot be separated from a shift of the state"
    if is_width_known:
        remainder = "only the width d_r + d_l can be known"
    return start + describe_shift(unknown[0], quantity, remainder)


def null_space_basis(M: Floats, tolerance: float) -> Floats:
    """Return an orthonormal basis (n x k) of the kernel of a matrix with entries of order 1.

    Args:
        M: the matrix (rows x n). All is kernel if it is empty.
        tolerance: singular values up to this count as 0.
    """
    if not M.size:
        return np.eye(M.shape[1])
    _, singular, rotation = np.linalg.svd(M)
    return np.asarray(rotation[int((singular > tolerance).sum()) :].T)


def unobservable_subspace(A: Floats, C: Floats, tolerance: float) -> Floats:
    """Return an orthonormal basis (n x k) of the largest A-invariant subspace in the kernel of
    C.

    Args:
        A: the system's matrix (n x n), of order 1.
        C: its outputs (p x n), of order 1.
        tolerance: singular values up to this count as 0.
    """
    U = null_space_basis(C, tolerance)
    while U.shape[1]:
        stays = null_space_basis(A @ U - U @ (U.T @ A @ U), tolerance)
        if stays.shape[1] == U.shape[1]:
            break
        U = U @ stays
    return U


def format_yes_no(verdict: Mapping[str, bool]) -> str:
    """Format the identifiability of an output: right yes, left NO, ..."""
    words = {True: "yes", False: "NO"}
    return ", ".join(f"{name} {words[bool(verdict[name])]}" for name in DIRECTIONS)
