"""Exact arithmetic: matrices of fractions, roots, and the exponential with a bound of its error."""

from __future__ import annotations

from fractions import Fraction
from math import isqrt
from typing import Any

Matrix = list[list[Fraction]]
ZERO, ONE = Fraction(0), Fraction(1)


class Refused(Exception):
    """Step of a proof that does not hold."""


def require(truth: Any, step: str) -> None:
    """Raise Refused unless a step holds."""
    if not truth:
        raise Refused(step)


def upper_root(x: Fraction) -> Fraction:
    """Return an upper bound of the square root of x, close to it."""
    shift = max(0, 64 + (x.denominator.bit_length() - x.numerator.bit_length()) // 2)
    return Fraction(isqrt((x.numerator << 2 * shift) // x.denominator) + 1, 1 << shift)


def mix_matrices(X: Matrix, Y: Matrix, a: Any = 1, b: Any = -1) -> Matrix:
    """Return a X + b Y."""
    return [[a * x + b * y for x, y in zip(*rows, strict=True)] for rows in zip(X, Y, strict=True)]


def transpose_rows(X: Any) -> Matrix:
    """Return a matrix with rows and columns exchanged."""
    return list(map(list, zip(*X, strict=True)))


def multiply_matrices(X: Matrix, *others: Matrix) -> Matrix:
    """Return the product of matrices."""
    for Y in others:
        X = [
            [sum(map(Fraction.__mul__, row, each), ZERO) for each in transpose_rows(Y)] for row in X
        ]
    return X


def extend_diagonal(X: Matrix, corners: list[Fraction]) -> Matrix:
    """Return a matrix with more entries on its diagonal, and zeros beside them."""
    for corner in corners:
        X = [*([*row, ZERO] for row in X), [ZERO] * len(X) + [corner]]
    return X


def eliminate_pivots(M: Matrix) -> list[Fraction]:
    """Return the pivots of elimination up to the first that is not positive."""
    require(transpose_rows(M) == M, "matrices are symmetric")
    found = [M[0][0]]
    while found[-1] > 0 and len(M) > 1:
        (top, *rest), *rows = M
        M = [[x - row[0] / top * y for x, y in zip(row[1:], rest, strict=True)] for row in rows]
        found.append(M[0][0])
    return found


def require_positive(M: Matrix, step: str) -> None:
    """Raise Refused unless a matrix is positive definite."""
    found = eliminate_pivots(M)
    require(len(found) == len(M) and found[-1] > 0, step)


def dual_form(P: Matrix, c: list[Fraction]) -> Fraction:
    """Return c'P^-1 c of a positive definite P."""
    return -eliminate_pivots([*([*row, x] for row, x in zip(P, c, strict=True)), [*c, ZERO]])[-1]


def upper_norm(P: Matrix, x: list[Fraction]) -> Fraction:
    """Return an upper bound of the root of x'P x, close to it."""
    return upper_root(multiply_matrices([x], P, transpose_rows([x]))[0][0])


def hold_exactly(A: Matrix, B: Matrix, Ts: Fraction) -> tuple[Matrix, Matrix, Fraction]:
    """Return e^(A Ts), the integral of e^(A s) B over a sample, and a bound of their errors.

    Terms are cut at 2^-200. Behind the last one each is at most half of the one before.
    """
    n, size, k = len(A), max(sum(map(abs, row)) for row in A) * Ts, 0
    require(size < 99, "hold: a sample is short enough for a series")
    term = [[Fraction(i == j) for j in range(n)] for i in range(n)]
    total, part = mix_matrices(term, term), mix_matrices(term, term)
    bound, cut, error = ONE, ZERO, ZERO  # largest rows: of the term, its cuts, all cuts before
    while bound > Fraction(1, 1 << 150) or 2 * size > k + 1:
        total, part = mix_matrices(total, term, 1, 1), mix_matrices(part, term, 1, Ts / (k + 1))
        k, error, bound = k + 1, error + cut, bound * size / (k + 1)
        cut = cut * size / k + Fraction(n, 1 << 200)
        rows = multiply_matrices(term, A)
        term = [[Fraction(int(x * Ts / k * (1 << 200)), 1 << 200) for x in row] for row in rows]
    largest = max(abs(x) for row in B for x in row)
    return total, multiply_matrices(part, B), (error + cut + 2 * bound) * max(ONE, n * Ts * largest)
