"""Old names of arguments and attributes, which work for one version with a warning."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def accept_renamed_argument(old: str, new: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator that lets a function accept an argument by its old name, with a warning.

    Args:
        old: keyword until version 0.1.
        new: keyword that replaced it.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        """Return the function with the old keyword."""

        @wraps(function)
        def translated(*args: P.args, **kwargs: P.kwargs) -> R:
            """Call the function with the new keyword."""
            if old in kwargs:
                warn_of_renamed(f"{function.__name__}: {old}", new)
                kwargs[new] = kwargs.pop(old)
            return function(*args, **kwargs)

        return translated

    return decorate


def warn_of_renamed(old: str, new: str) -> None:
    """Warn the caller's caller that a name was replaced."""
    warnings.warn(
        f"{old} is now {new}. The old name goes in version 0.2", DeprecationWarning, stacklevel=3
    )
