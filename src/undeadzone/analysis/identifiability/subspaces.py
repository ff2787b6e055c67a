"""Subspaces as orthonormal bases: the kernel of a matrix, what outputs do not observe."""

from __future__ import annotations

import numpy as np

from undeadzone.support.arrays import Floats


def kernel(M: Floats, tolerance: float) -> Floats:
    """Orthonormal basis (n x k) of the kernel of a matrix whose entries are of order 1.

    Args:
        M: the matrix (rows x n); all is kernel if it is empty.
        tolerance: singular values up to this count as 0.
    """
    if not M.size:
        return np.eye(M.shape[1])
    _, singular, rotation = np.linalg.svd(M)
    return np.asarray(rotation[int((singular > tolerance).sum()) :].T)


def unobservable(A: Floats, C: Floats, tolerance: float) -> Floats:
    """Orthonormal basis (n x k) of the largest A-invariant subspace in the kernel of C.

    Args:
        A: the system's matrix (n x n), of order 1.
        C: its outputs (p x n), of order 1.
        tolerance: singular values up to this count as 0.
    """
    U = kernel(C, tolerance)
    while U.shape[1]:
        stays = kernel(A @ U - U @ (U.T @ A @ U), tolerance)
        if stays.shape[1] == U.shape[1]:
            break
        U = U @ stays
    return U
