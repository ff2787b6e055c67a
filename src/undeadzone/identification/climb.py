"""Levenberg and Marquardt's climb to the top of a likelihood."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from undeadzone.support.answers import Answers
from undeadzone.support.arrays import Floats, Integers

Quadratic = Callable[[Floats], tuple[float, Floats, Floats]]


class Top(NamedTuple):
    """Where a climb ended: the numbers, the log likelihood there, the steps taken."""

    theta: Floats
    value: float
    steps: int


class KeptClimbs:
    """Tops of climbs on disk: a log that is identified once more climbs to none of them again.

    Args:
        answers: the file; a log asks for its climbs in the same order each time.
    """

    def __init__(self, answers: Answers) -> None:
        self._answers: Answers | None = answers
        self._count = 0

    def close(self) -> None:
        """Keep no more: what is asked of an answer later, as for a figure, is no part of it."""
        self._answers = None

    def top(self, start: Floats, compute: Callable[[], Top]) -> Top:
        """The top of the next climb, from the file or computed and kept.

        Args:
            start: where the climb begins (P).
            compute: climbs.
        """
        if self._answers is None:
            return compute()
        self._count += 1
        question = [self._count, hashlib.blake2b(start.tobytes(), digest_size=16).hexdigest()]

        def answer(missing: list[int]) -> Iterator[tuple[int, Any]]:
            top = compute()
            yield 0, [top.theta.tolist(), float(top.value), top.steps]

        theta, value, steps = self._answers.of([question], answer)[0]
        return Top(np.array(theta), value, steps)


def climb(
    value: Callable[[Floats], float],
    quadratic: Quadratic,
    theta: Floats,
    free: Integers,
    steps: int = 60,
    gain: float = 1e-4,
    project: Callable[[Floats], Floats] | None = None,
    longest: Floats | None = None,
    kept: KeptClimbs | None = None,
) -> Top:
    """Raise a log likelihood by damped Newton steps.

    Args:
        value: the log likelihood; -inf where theta makes no sense.
        quadratic: value, score and a positive Hessian, of the free numbers.
        theta: where to start (P).
        free: places of the numbers that may change.
        steps: how many trials at most.
        gain: two steps in a row that gain less than this end the climb.
        project: what brings a trial back within bounds.
        longest: the longest step of each free number; default any.
        kept: tops that are on disk; None: none are.

    Returns:
        The best theta found.
    """
    if kept is not None:
        numbers = (theta, free, steps, gain, project, longest)
        return kept.top(theta, partial(climb, value, quadratic, *numbers))
    best = quadratic(theta)
    top, damping, small = theta, 1e-2, 0
    for count in range(steps):
        current, score, hessian = best
        trial = top.copy()
        step = _step(score, hessian, damping)
        trial[free] += step if longest is None else np.clip(step, -longest, longest)
        if project is not None:
            trial = project(trial)
        reached = value(trial)
        if not reached > current:
            damping *= 6
            if damping > 1e8:
                return Top(top, current, count)
            continue
        rise = reached - current
        top, best = trial, quadratic(trial)
        damping = max(damping / 5, 1e-9)
        small = small + 1 if rise < gain + 1e-8 * abs(reached) else 0
        if small >= 2:
            return Top(top, reached, count)
    return Top(top, best[0], steps)


def _step(score: Floats, hessian: Floats, damping: float) -> Floats:
    """The damped Newton step, scaled by the Hessian's diagonal."""
    diagonal = np.maximum(np.diag(hessian), 0.0)
    scale = np.sqrt(diagonal + 1e-14 * diagonal.sum()) + 1e-12
    scaled = hessian / np.outer(scale, scale)
    try:
        step = np.linalg.solve(scaled + damping * np.eye(scale.size), score / scale) / scale
    except np.linalg.LinAlgError:
        step = score / scale**2
    return step if np.isfinite(step).all() else np.zeros(scale.size)
