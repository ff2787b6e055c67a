"""Linear objectives over linear matrix inequalities, handed to Clarabel as they stand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from undeadzone.util.arrays import Floats

ACCEPTED = 0.1  # residual of the solver's answer; whoever needs a proof checks the answer itself


def minimise(cost: Floats, blocks: Callable[[Floats], list[Floats]]) -> Floats | None:
    """Return x that minimises cost'x with every block(x) >= 0; None if there is none.

    The answer is the solver's: whoever uses it as a proof checks it (`dissipation.check`).

    Args:
        cost: (n).
        blocks: affine in x; 2-D ones are to be positive semidefinite, 1-D ones non-negative. Their
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
        [_cone(block) for block in constant],
        settings,
    )
    solution = solver.solve()
    x = np.asarray(solution.x)
    infeasible = "Infeasible" in str(solution.status) or x.size != size
    if infeasible or not max(solution.r_prim, solution.r_dual) < ACCEPTED:
        return None
    return x


def symmetric(entries: Floats, n: int) -> Floats:
    """Return the symmetric n x n matrix with these n (n + 1) / 2 entries, its upper triangle by
    rows.
    """
    P = np.zeros((n, n))
    row, column = np.triu_indices(n)
    P[row, column] = P[column, row] = entries
    return P


def _cone(block: Floats) -> Any:
    """Return Clarabel's cone of a block."""
    import clarabel

    if block.ndim == 1:
        return clarabel.NonnegativeConeT(block.size)
    return clarabel.PSDTriangleConeT(block.shape[0])


def _stack_blocks(blocks: list[Floats]) -> Floats:
    """Return all blocks in one vector."""
    return np.concatenate([_vector(block) for block in blocks])


def _vector(block: Floats) -> Floats:
    """Return a vector as it is; of a matrix the upper triangle column by column, as Clarabel wants
    it.

    Entries off the diagonal are multiplied by sqrt 2.
    """
    if block.ndim == 1:
        return block
    column, row = np.tril_indices(block.shape[0])
    return block[row, column] * np.where(row == column, 1.0, np.sqrt(2.0))
