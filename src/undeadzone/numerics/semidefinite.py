"""Linear objectives over linear matrix inequalities, handed to Clarabel as they stand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from undeadzone.support.arrays import Floats


def minimise(cost: Floats, blocks: Callable[[Floats], list[Floats]]) -> Floats | None:
    """x that minimises cost'x with every block(x) positive semidefinite (2-D) or non-negative (1-D); None if there is none.

    The blocks must be affine in x; their coefficients are read off at the unit vectors. The answer is the solver's:
    whoever uses it as a proof checks it (`dissipation.check`).
    """
    import clarabel
    from scipy import sparse

    size = cost.size
    constant = blocks(np.zeros(size))
    right = np.concatenate([_vector(block) for block in constant])
    columns = [
        right - np.concatenate([_vector(block) for block in blocks(unit)]) for unit in np.eye(size)
    ]
    cones = [
        clarabel.NonnegativeConeT(block.size)
        if block.ndim == 1
        else clarabel.PSDTriangleConeT(block.shape[0])
        for block in constant
    ]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    problem = (
        sparse.csc_matrix((size, size)),
        cost,
        sparse.csc_matrix(np.stack(columns, axis=1)),
        right,
        cones,
        settings,
    )
    solution = clarabel.DefaultSolver(*problem).solve()
    x = np.asarray(solution.x)
    if (
        "Infeasible" in str(solution.status)
        or x.size != size
        or not max(solution.r_prim, solution.r_dual) < 0.1
    ):
        return None
    return x


def symmetric(entries: Floats, n: int) -> Floats:
    """The symmetric n x n matrix with these n (n + 1) / 2 entries."""
    P = np.zeros((n, n))
    row, column = np.triu_indices(n)
    P[row, column] = P[column, row] = entries
    return P


def _vector(block: Floats) -> Floats:
    """A vector as it is; a matrix's upper triangle column by column, off-diagonals times sqrt 2, as Clarabel's cone wants it."""
    if block.ndim == 1:
        return block
    column, row = np.tril_indices(block.shape[0])
    return block[row, column] * np.where(row == column, 1.0, np.sqrt(2.0))
