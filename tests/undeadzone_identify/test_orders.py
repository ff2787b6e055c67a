"""Which order, and whether a zone at all."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from undeadzone_identify.selection import orders


@pytest.mark.parametrize(("robust", "weight"), [(6.0, 3.0), (0.5, 1.0), (200.0, 100.0)])
def test_errors_that_depend_on_each_other_count_less_for_a_zone(
    monkeypatch: pytest.MonkeyPatch, robust: float, weight: float
) -> None:
    """A zone gains 3 nats; the variance of its width is 2 if errors are independent."""
    spread = SimpleNamespace(V=robust * np.eye(1), naive=2 * np.eye(1))
    objective = SimpleNamespace(
        kind="behind",
        simulator=None,
        readings=SimpleNamespace(ok=None),
        layout=SimpleNamespace(widths=slice(1, 3)),
        robust_covariance=lambda theta: spread,
        width_weights=lambda *pair: np.ones(1),
    )
    fit: Any = SimpleNamespace(objective=objective, theta=np.zeros(4), value=-7.0)
    linear = SimpleNamespace(theta=np.zeros(4), value=-10.0)
    monkeypatch.setattr(orders.zone_fit, "fit_linear", lambda *given: linear)
    monkeypatch.setattr(orders.zone_fit, "widths_about_level", lambda *given: np.ones(2))
    monkeypatch.setattr(orders.zone_fit, "improve_fit", lambda fit, begun: fit)
    found = orders.compare_with_no_zone(fit)
    assert found.chance == pytest.approx(chi2.sf(6.0 / weight, 1))
    assert found.fit is fit
