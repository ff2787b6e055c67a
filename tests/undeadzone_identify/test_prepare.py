"""Logs as a fit takes them."""

from __future__ import annotations

import numpy as np
import pytest

from undeadzone.errors import InputError
from undeadzone.nonlinearities.sensor import deadzone
from undeadzone_identify.logs.grid import to_grid
from undeadzone_identify.logs.log import Options, log_from_arrays
from undeadzone_identify.logs.prepare import prepare_log


@pytest.mark.parametrize("ahead", [True, False])
def test_exact_zeros_say_that_noise_acts_ahead_of_the_zone(ahead: bool) -> None:
    """A third of the readings is silent; behind the zone noise leaves no zeros."""
    draw = np.random.default_rng(7)
    u = np.sin(np.arange(2000) * 0.03) + 0.1 * draw.normal(size=2000)
    noise = 0.02 * draw.normal(size=2000)
    y = deadzone(u + noise, 0.4, 0.4) if ahead else deadzone(u, 0.4, 0.4) + noise
    log = log_from_arrays(u=u, y=y, t=np.arange(2000) * 0.01)
    assert prepare_log(to_grid([log]), Options()).data.silent_zeros is ahead


def test_noise_ahead_of_a_zone_that_no_reading_shows_is_refused() -> None:
    y = 1.0 + np.random.default_rng(8).random(200)
    log = log_from_arrays(u=y - 1.0, y=y, t=np.arange(200) * 0.01)
    with pytest.raises(InputError, match="no reading is silent"):
        prepare_log(to_grid([log]), Options(noise="before"))
