"""A claimed centre: what the filters start from, and what the verdict makes of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from scenes import scene
from undeadzone.errors import InputError, ShapeError
from undeadzone.nonlinearities.sensor import Sensor, resolve
from undeadzone.observers.filtering.prior import Assumptions, build_prior
from undeadzone.plants.build import system
from undeadzone.plants.options import Plant
from undeadzone.plants.system import sample_plant
from undeadzone.results.run import Run
from undeadzone.simulation.simulate import simulate
from undeadzone.synthesis.check import check

MOTOR = {"A": [[0.0, 1.0], [0.0, -10.0]], "B": [[0.0], [50.0]], "C": [[1.0, 0.0]]}
MODEL = sample_plant(system(Plant(**MOTOR, x0=[0.0, 0.0])), 0.01)


def motor(**observer: Any) -> Any:
    return scene(
        plant=MOTOR | {"x0": [0.3, 0.0]},
        sensor={"right": 0.12, "left": 0.12, "noise": 0.002},
        reference={"kind": "sine", "amplitude": 1.5, "frequency": 0.5},
        observer={"method": "kalman", "right": [0.0, 0.5]} | observer,
        controller={"method": "state_feedback"},
        simulation={"time": "sampled", "step": 0.01, "duration": 8.0},
    )


def known(run: Run) -> tuple[bool, bool]:
    (verdict,) = run.info.identifiable
    return verdict["width"], verdict["right"] and verdict["left"] and verdict["centre"]


@pytest.mark.parametrize("claimed", [0.0, [-0.1, 0.1], [[0.05, 0.2]]])
def test_the_prior_is_that_of_ranges_given_the_centre(claimed: Any) -> None:
    """Of many draws from the ranges as Gaussians, weighed by the claim on d_r - d_l."""
    where = resolve(Sensor(right=0.1, left=0.1, noise=0.01), 1, 0.01)
    ranges = {"right": [0.2, 1.0], "left": [0.0, 0.6]}
    prior = build_prior(Assumptions(**ranges, x_std=1.0, drift=0.0), MODEL, where, centre=claimed)
    mean, cov = prior.widths()
    low, high = np.broadcast_to(np.ravel(claimed), 2)
    spread = max((high - low) / np.sqrt(12), 0.01)
    rng = np.random.default_rng(0)
    drawn = rng.normal([0.6, 0.3], np.array([0.8, 0.6]) / np.sqrt(12), (400_000, 2))
    off = (drawn[:, 0] - drawn[:, 1] - (low + high) / 2) / spread
    weight = np.exp(-(off**2) / 2)
    np.testing.assert_allclose(mean, np.average(drawn, axis=0, weights=weight), atol=5e-3)
    expected = np.cov(drawn.T, aweights=weight)
    np.testing.assert_allclose(cov, expected, atol=2e-3)
    if high == low:
        assert abs(cov[0, 0] - cov[0, 1]) < 1e-12  # d_r - d_l has no spread


@pytest.mark.parametrize("method", ["kalman", "censored", "auto", "extended"])
def test_with_a_claimed_centre_both_edges_of_an_integrator_become_known(method: str) -> None:
    run = simulate(motor(method=method, centre=0.0))
    assert known(run) == (True, True)
    assert run.info.identifiable[0]["reasons"][-1].endswith("from the declared centre alone")
    np.testing.assert_allclose(run.widths, 0.12, atol=0.01)
    assert run.rms_estimation < 0.01


def test_without_a_claim_the_centre_of_an_integrator_stays_unknown() -> None:
    assert known(simulate(motor())) == (True, False)
    assert "observer.centre" in check(motor()).cures[0]
    assert check(motor(centre=0.0)).cures == ()


def test_a_vague_centre_is_known_as_well_as_it_is_claimed() -> None:
    run = simulate(motor(centre=[-0.1, 0.1]))
    assert known(run) == (True, True)
    deviation = run.info.identifiable[0]["std"]["centre"]
    assert deviation == pytest.approx(0.2 / np.sqrt(12), rel=1e-3)
    assert known(simulate(motor(centre=[-0.45, 0.45]))) == (True, False)  # wider than the zone


@pytest.mark.parametrize(("x_std", "tells"), [([0.01, 0.1], True), ([1.0, 1.0], False)])
def test_homing_tells_the_centre_of_a_linear_plant(x_std: list[float], tells: bool) -> None:
    """A known start counts, a vague one does not; its deviation is twice that of the position."""
    run = simulate(motor(x_std=x_std))
    assert known(run) == (True, tells)
    if tells:
        verdict = run.info.identifiable[0]
        assert verdict["std"]["centre"] == pytest.approx(2 * x_std[0], rel=0.05)
        assert verdict["reasons"][-1].endswith("from the declared start alone")


@pytest.mark.parametrize(
    ("claimed", "error", "words"),
    [
        ([0.2, 0.1], InputError, "lo <= hi"),
        (0.7, InputError, "the ranges of d_r and d_l allow"),
        ([0.0, 0.1, 0.2], ShapeError, "the range .lo, hi. of d_r - d_l"),
    ],
)
def test_impossible_centres_are_refused(claimed: Any, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=f"observer.centre: .*{words}"):
        simulate(motor(centre=claimed))
