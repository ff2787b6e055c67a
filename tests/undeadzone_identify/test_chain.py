"""From an answer to code that compensates, and plants behind an element of the input."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from requirements import needs
from undeadzone_export.snippet import Lost
from undeadzone_identify.chain import run_snippet_chain
from undeadzone_identify.models import chain as models


@needs("compiler", "gcc")
def test_an_axis_is_off_by_its_gap_and_with_the_code_hardly(tmp_path: Path) -> None:
    """The command goes to and fro ten times the gap."""
    gap = (0.2, 0.19, 0.21)
    lost = Lost("backlash", gap, gap, gap, "mm", "log.csv", is_ahead=True)
    signal = np.sin(np.arange(2000) * 0.01)
    found = run_snippet_chain(lost, signal, tmp_path)
    assert found.numbers["axis_off"] == pytest.approx(0.2, rel=0.01)
    assert found.numbers["axis_off_with_code"] < 0.02
    assert "up to 0.2 mm of an axis simulated with this gap" in found.words["axis off"]


@pytest.mark.parametrize(
    ("delayed", "orders", "tried"),
    [
        (False, range(1, 5), [("own", 2), ("own", 3)]),
        (False, range(1, 3), [("own", 2)]),
        (True, range(1, 5), [("own", 2), ("own", 3), *[("whole", n) for n in (2, 3, 4)]]),
    ],
)
def test_the_order_of_the_fit_and_the_next_are_tried(
    monkeypatch: pytest.MonkeyPatch, delayed: bool, orders: range, tried: list[tuple[str, int]]
) -> None:
    """And two above it where a delay may be that of an element of the input."""
    y = np.zeros(5)
    own = SimpleNamespace(name="own", y=y, u=np.ones(5))
    whole: Any = SimpleNamespace(name="whole", y=y, u=np.ones(5) + delayed)
    layout = SimpleNamespace(m=1, n=2, integrators=0)
    starts = SimpleNamespace(simulator=SimpleNamespace(layout=layout, data=own))
    simulated: list[tuple[str, int]] = []

    def stop(*given: Any) -> None:
        raise StopIteration

    monkeypatch.setattr(models, "PlaceStarts", lambda fit: starts)
    monkeypatch.setattr(
        models, "PlantSimulator", lambda data, n, more: simulated.append((data.name, n))
    )
    monkeypatch.setattr(models, "scan_input", stop)
    fit: Any = None
    with pytest.raises(StopIteration):
        models.fit_chains(fit, {}, whole, orders)
    assert simulated == tried
