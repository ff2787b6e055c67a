"""Structure: unobservable and uncontrollable modes whatever the coordinates and scale."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes import PAPER_PLANT, random_plant, seeds
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.structure import (
    output_chains,
    require_structure,
    uncontrollable_modes,
    unobservable_modes,
)
from undeadzone.plants.options import Plant, linear_matrices


@given(seeds, st.integers(1, 5), st.integers(1, 2))
def test_random_pairs_are_observable_and_controllable(seed: int, n: int, channels: int) -> None:
    A, B, C = random_plant(np.random.default_rng(seed), n, channels, channels).linear
    assert unobservable_modes(A, C) == uncontrollable_modes(A, B) == []


@given(seeds, st.integers(1, 3), st.integers(1, 3))
def test_a_hidden_part_is_found_in_any_coordinates(seed: int, seen: int, hidden: int) -> None:
    """A block that no output sees, in random coordinates: its eigenvalues are listed."""
    rng = np.random.default_rng(seed)
    one = rng.normal(size=(seen, seen)) + 3 * np.eye(seen)
    other = rng.normal(size=(hidden, hidden)) - 3 * np.eye(hidden)
    T = np.linalg.qr(rng.normal(size=(seen + hidden, seen + hidden)))[0]
    coupling = rng.normal(size=(hidden, seen))
    A = T @ np.block([[one, np.zeros((seen, hidden))], [coupling, other]]) @ T.T
    C = np.hstack([rng.normal(size=(1, seen)), np.zeros((1, hidden))]) @ T.T
    expected = pytest.approx(np.sort_complex(np.linalg.eigvals(other)), abs=1e-5)
    assert np.sort_complex(np.array(unobservable_modes(A, C))) == expected
    assert np.sort_complex(np.array(uncontrollable_modes(A.T, C.T))) == expected


@pytest.mark.parametrize("rate", [1e-6, 1e-3, 1.0, 1e3, 1e6])
@pytest.mark.parametrize(
    "form",
    [{"companion": [6.0, 11.0, 6.0]}, {"companion": [24.0, 50.0, 35.0, 10.0]}, {"integrators": 5}],
)
def test_slow_and_fast_plants_are_judged_alike(form: dict[str, Any], rate: float) -> None:
    """The same plant in another unit of time."""
    A, B, C = linear_matrices(Plant(**form))
    n = A.shape[0]
    A = np.where(np.arange(n)[:, None] == n - 1, A * rate ** (n - np.arange(n)), A)
    require_structure(Matrices(A, B, C), "plant")


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1e3, 1e9])
def test_a_slow_plant_is_as_observable_as_a_fast_one(unit: float) -> None:
    A, B, C = PAPER_PLANT.linear
    assert unobservable_modes(unit * A, C) == []
    assert uncontrollable_modes(unit * A, B) == []
    hidden = unobservable_modes(unit * np.diag([-1.0, -2.0]), np.array([[1.0, 0.0]]))
    assert np.allclose(hidden, [-2.0 * unit])


@given(seeds)
def test_an_output_that_is_the_derivative_of_another_one_is_not_counted_twice(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, first = rng.normal(size=(4, 4)), rng.normal(size=4)
    chains = output_chains(A, np.stack([first, first @ A]))
    rows = chains.O / np.linalg.norm(chains.O, axis=1, keepdims=True)
    assert rows.shape == (4, 4)
    assert np.linalg.cond(rows) < 1e8
