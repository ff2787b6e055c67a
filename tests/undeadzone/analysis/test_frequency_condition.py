"""The certificate agrees with the frequency condition and closed forms.

The default gain is always certified.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes import PAPER_PLANT, linear, random_plant, response, seeds
from undeadzone.analysis.certificate.passivity import certify, passive_gain
from undeadzone.errors import StructureError
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import companion_form
from undeadzone.plants.options import Plant, linear_matrices

GAMMA = np.array([10.0])


@given(st.floats(-3, 20), st.floats(-3, 20))
def test_the_papers_plant_is_certified_exactly_where_theory_says(l1: float, l2: float) -> None:
    """2 b1 > (sqrt(b0) - 1)^2 with b1 = 2 + l1, b0 = 1 + 2 l1 + l2 > 0 (docs/certificate.md)."""
    b1, b0 = 2 + l1, 1 + 2 * l1 + l2
    slack = 2 * b1 - (np.sqrt(max(b0, 0.0)) - 1) ** 2
    if min(abs(slack), abs(b0)) < 0.05 * (1 + abs(b1) + abs(b0)):
        return
    expected = slack > 0 and b0 > 0
    assert certify(PAPER_PLANT.linear, np.array([[l1], [l2]]), GAMMA).certified == expected


def test_the_papers_gains_miss_it_narrowly() -> None:
    """(12, 15): 28 < 28.35, min Re (1 + G) = -0.0417 at 2.49 rad/s. (1, 1.5) is certified."""
    missed = certify(PAPER_PLANT.linear, np.array([[12.0], [15.0]]), GAMMA)
    assert not missed.certified
    w = np.linspace(0.01, 20, 20001)
    from_gains = PAPER_PLANT.linear._replace(B=np.array([[12.0], [15.0]]))
    real = 1 + response(from_gains, 1j * w)[:, 0, 0].real
    assert real.min() == pytest.approx(-0.0417, abs=1e-4)
    assert w[np.argmin(real)] == pytest.approx(2.49, abs=0.01)
    assert certify(PAPER_PLANT.linear, np.array([[1.0], [1.5]]), GAMMA).certified


@given(seeds, st.integers(1, 5))
def test_agrees_with_the_frequency_condition_on_random_designs(seed: int, n: int) -> None:
    """Certified iff A is stable and Re (1 + G) > 0; sampled: iff gamma Ts < 2 (1 + min Re G)."""
    rng = np.random.default_rng(seed)
    plant, L = random_plant(rng, n).linear, rng.normal(size=(n, 1)) * 2
    s = 1j * np.concatenate([[0.0], np.logspace(-3, 3, 3000)])
    least = 1 + response(plant._replace(B=L), s).real.min()
    if abs(least) > 0.02:
        assert certify(plant, L, GAMMA).certified == (least > 0)
    Ts = 0.1
    sampled = zoh(plant, Ts)
    z = np.exp(1j * np.concatenate([np.logspace(-5, 0, 2000) * np.pi, [0.0]]))
    least = 1 + response(sampled._replace(B=Ts * L), z).real.min()
    for gamma in (1.0, 8.0):
        if abs(2 * least - gamma * Ts) > 0.04:
            assert certify(sampled, L, np.array([gamma]), Ts).certified == (gamma * Ts < 2 * least)


@given(seeds, st.integers(1, 5), st.integers(1, 2), st.booleans())
def test_default_gain_is_certified_for_every_stable_plant(
    seed: int, n: int, p: int, in_samples: bool
) -> None:
    Ts = 0.05 if in_samples else None
    plant = random_plant(np.random.default_rng(seed), n, 1, p).linear
    plant = plant if Ts is None else zoh(plant, Ts)
    assert certify(plant, passive_gain(plant, Ts), np.full(p, 5.0), Ts).certified


@pytest.mark.parametrize("order", [1, 2, 3])
def test_chains_of_integrators_have_no_certificate(order: int) -> None:
    chain = linear_matrices(Plant(integrators=order))
    gain = np.poly(-np.ones(order))[1:, None]
    assert not certify(chain, gain, np.array([1.0])).certified
    with pytest.raises(StructureError, match="no gain is passive"):
        passive_gain(chain, None)


@pytest.mark.parametrize("Ts", [None, 0.1])
def test_unstable_plants_have_none_whatever_the_gain(Ts: float | None) -> None:
    plant = linear([[0.0, 1.0], [1.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]]).linear
    plant = plant if Ts is None else zoh(plant, Ts)
    assert not certify(plant, np.array([[5.0], [6.0]]), np.array([1.0]), Ts).certified


@pytest.mark.parametrize("Ts", [1e-4, 5e-3, 1e-2, 0.1, 1.0])
def test_the_default_gain_is_certified_at_every_sample_time(Ts: float) -> None:
    """With every gamma up to 1 / Ts, also for poles far apart.

    P^-1 C' of the continuous theory is not certified there.
    """
    stiff = zoh(companion_form(np.poly([-1.0, -10.0, -1000.0])[:0:-1], [1000.0]), Ts)
    for gamma in (1e-3 / Ts, 1 / Ts):
        assert certify(stiff, passive_gain(stiff, Ts), np.array([gamma]), Ts).certified
