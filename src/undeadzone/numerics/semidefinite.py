"""Linear objectives over linear matrix inequalities, solved by Clarabel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from undeadzone.util.arrays import Floats

ACCEPTED = 0.1  # residual of the solver's answer; whoever needs a proof checks the answer itself


def minimise_semidefinite(cost: Floats, blocks: Callable[[Floats], list[Floats]]) -> Floats | None:
    """Return x that minimises cost'x with every block(x) >= 0 (n), or None if it is
    infeasible.

    The answer is the solver's: whoever uses it as a proof checks it (`dissipation.check`).

    Args:
        cost: (n).
        blocks: affine in x (2-D ones are to be positive semidefinite, 1-D ones non-negative). Their
            coefficients are read off at the unit vectors.
    """
    import clarabel
    from scipy import sparse

    size = cost.size
    constant = blocks(np.zeros(size))
    right = _stack_blocks(constant)
    columns = [right - _stack_blocks(blocks(unit)) for unit in np.eye(size)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix((size, size)),
        cost,
        sparse.csc_matrix(np.stack(columns, axis=1)),
        right,
        list(map(_clarabel_cone, constant)),
        settings,
    )
    solution = solver.solve()
    x = np.asarray(solution.x)
    infeasible = "Infeasible" in str(solution.status) or x.size != size
    if infeasible or not max(solution.r_prim, solution.r_dual) < ACCEPTED:
        return None
    return x


def symmetric_matrix(entries: Floats, n: int) -> Floats:
    """Return the symmetric n x n matrix with the given n (n + 1) / 2 entries, its upper
    triangle by rows.
    """
    P = np.zeros((n, n))
    row, column = np.triu_indices(n)
    P[row, column] = P[column, row] = entries
    return P


def _clarabel_cone(block: Floats) -> Any:
    """Return Clarabel's cone of a block."""
    import clarabel

    if block.ndim == 1:
        return clarabel.NonnegativeConeT(block.size)
    return clarabel.PSDTriangleConeT(block.shape[0])


def _stack_blocks(blocks: list[Floats]) -> Floats:
    """Return all blocks in a single vector."""
    return np.concatenate(list(map(_block_to_vector, blocks)))


def _block_to_vector(block: Floats) -> Floats:
    """Return a vector unchanged, or the upper triangle of a matrix column by column, as
    Clarabel expects.

    Entries off the diagonal are multiplied by sqrt 2.
    """
    if block.ndim == 1:
        return block
    column, row = np.tril_indices(block.shape[0])
    return block[row, column] * np.where(row == column, 1.0, np.sqrt(2.0))
