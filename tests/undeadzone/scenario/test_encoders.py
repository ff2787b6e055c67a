"""A rigid link on a horizontal table: only a declared start makes its centre known.

Without one a filter never claims to know it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import undeadzone as uz
from scenes import EXACT_SENSOR, tables_of
from undeadzone.scenario.reader import convert


def run(**observer: Any) -> uz.Run:
    return uz.simulate(
        convert(
            tables_of("""
                plant = { arm = { kind = "one_link" }, parameters = { g = 0.0, b1 = 0.1 } }
                reference = { kind = "sine", amplitude = 0.5, frequency = 0.5 }
                controller = { method = "computed_torque", bandwidth = 10.0 }
                simulation = { time = "sampled", duration = 4.0, step = 0.004, substeps = 1 }
                """)
            | {
                "sensor": {"right": 0.08, "left": 0.05, "noise": 1e-3} | EXACT_SENSOR,
                "observer": {"method": "extended", "right": [0.0, 0.15], "disturbance": 0.05}
                | observer,
            }
        )
    )


@pytest.mark.parametrize("start", [{}, {"x_std": 0.3}])
def test_no_centre_without_a_start_that_tells_it(start: dict[str, float]) -> None:
    found = run(**start)
    (verdict,) = found.info.identifiable
    assert (verdict["width"], verdict["centre"]) == (True, False)
    assert found.d_std is not None
    centre, width = found.widths[0] @ [1, -1] - 0.03, found.widths.sum() - 0.13
    assert abs(width) < 1e-3 < 0.015 < abs(centre)
    assert found.d_std[-1].min() > 0.02  # the filter does not claim it either


def test_a_known_start_tells_the_centre_as_well_as_the_start_is_known() -> None:
    found = run(x_std=0.002)
    (verdict,) = found.info.identifiable
    assert verdict["reasons"] == ["right, left, centre from the declared start alone"]
    assert verdict["std"]["centre"] == pytest.approx(0.002, rel=0.01)
    np.testing.assert_allclose(found.widths, [[0.08, 0.05]], atol=0.005)
    assert found.d_std is not None
    np.testing.assert_allclose(
        found.d_std[-1], [verdict["std"]["right"], verdict["std"]["left"]], rtol=0.3
    )
