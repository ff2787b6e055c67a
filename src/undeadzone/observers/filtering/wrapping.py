"""An observer inside another one, which has numbers and a state of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from undeadzone.interfaces import Observer
from undeadzone.util import tree


def wrap_observer(
    observer: Observer,
    field: str,
    numbers: Any,
    start: Callable[[Any], Any],
    step: Callable[..., Any],
) -> Observer:
    """Return an observer around another one.

    Args:
        observer: the inner one.
        field: name of the outer numbers, behind the inner ones.
        numbers: tree of the outer numbers.
        start: start(inner state) is the state at t = 0, with the inner one in its field `observer`.
        step: the outer step, as of `Observer`.
    """
    kind = type(observer.params)

    def init(q: Any) -> Any:
        """Return the state at t = 0."""
        return start(observer.init(tree.drop_last_field(q, kind)))

    def project(q: Any, s: Any) -> Any:
        """Return the state with the observer's part projected."""
        return s._replace(observer=observer.project(tree.drop_last_field(q, kind), s.observer))

    params = tree.append_field(observer.params, field, numbers)
    return Observer(params, init, step, project, observer.traits)
