"""Contacts of gears along a planned torque."""

from __future__ import annotations

import numpy as np

from undeadzone.analysis.identifiability.flanks import flank_visits


def test_a_load_of_one_sign_presses_on_one_flank() -> None:
    tau = np.concatenate([np.zeros(500), np.ones(500), np.zeros(500)])[:, None]
    (found,) = flank_visits(tau, 0.01)
    assert found == (True, False, 0)
