"""What varies: an address is the number it names, a distribution SciPy's; mistakes are named."""

from __future__ import annotations

import json
import tomllib
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from scenes import random_plant, scene, seeds, table, tables_of
from undeadzone.compile import interpret
from undeadzone.errors import InputError, UndeadzoneError
from undeadzone.linalg import hold
from undeadzone.plants.system import sample_plant
from undeadzone.scenario.address import matching
from undeadzone.scenario.ensemble_table import TABLE, Distribution, Vary, spread
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import convert, parse
from undeadzone.signals.exosystem import Random, Sine, Step
from undeadzone.simulation.loop import Loop
from undeadzone.simulation.simulate import prepare
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone_studies.ensemble.binding import Binding, bind_ensemble, initial_copies
from undeadzone_studies.ensemble.varied import channel_amplitudes

AT_100_HZ = {"time": "sampled", "step": 0.01, "duration": 2.0}
MODEL = tables_of("""
A = [[0.0, 1.0], [-1.0, -2.0]]
B = [[0.0], [1.0]]
C = [[1.0, 0.0]]
""")
PLANT = MODEL | {"x0": [0.5, 0.0]}
TWO = tables_of("""
plant.A = [[-1.0, 0.5], [0.0, -2.0]]
plant.B = [[1.0, 0.0], [0.0, 1.0]]
plant.C = [[1.0, 0.0], [0.0, 1.0]]
sensor = { right = [0.5, 0.2], left = 0.3, noise = [0.0, 0.1] }
observer = { method = "certified" }
reference = { kind = "sine", amplitude = [2.0, 1.5], frequency = 0.5 }
""")
OBSERVER = table()["observer"]


def bound(
    entries: dict[str, Any], ensemble: dict[str, Any] | None = None, **changes: Any
) -> Binding:
    problem = resolve_scenario(scene(ensemble=(ensemble or {}) | entries, **changes))
    return bind_ensemble(problem, closed_once(json.dumps(changes)))


@cache
def closed_once(changes: str) -> Loop:
    """The loop of a scenario with changes: it is the same whatever varies."""
    return prepare(resolve_scenario(scene(**json.loads(changes))))[0]


def uniform(low: float = 0.5, high: float = 1.5, **words: Any) -> dict[str, Any]:
    return {"uniform": [low, high], **words}


# --- an address is the number of the scenario ---

SAME = tomllib.loads(Path(__file__).with_name("addresses.toml").read_text(encoding="utf-8"))["rows"]


@pytest.mark.parametrize("simulation", [{"step": 2e-3}, AT_100_HZ], ids=["continuous", "sampled"])
@pytest.mark.parametrize(
    ("address", "value", "base", "changed"), SAME, ids=[case[0] for case in SAME]
)
def test_a_run_is_that_of_the_scenario_with_the_number_written_in(
    address: str,
    value: float,
    base: str,
    changed: str,
    simulation: dict[str, Any],
) -> None:
    ensemble = {address: uniform(value, value)}
    problem = resolve_scenario(scene(base, ensemble=ensemble, simulation=simulation))
    loop, _, exogenous = prepare(problem)
    other = prepare(resolve_scenario(scene(changed, simulation=simulation)))
    other_loop, other_state, other_exogenous = other
    binding = bind_ensemble(problem, loop)
    state, params = binding.numbers.pack_lane(binding.draw_columns(0, 1, 1)[0])
    if "noise" in address:
        exogenous = other_exogenous  # drawn also where the nominal noise is 0
    varied, _ = interpret.run_interpreted(loop.step, state, exogenous, params)
    other_params = tree.pack_tree(other_loop.params)
    expected, _ = interpret.run_interpreted(
        other_loop.step, other_state, other_exogenous, other_params
    )
    assert np.isfinite(expected).all()
    np.testing.assert_allclose(varied, expected, rtol=1e-11, atol=1e-11)
    nominal, _ = interpret.run_interpreted(
        loop.step, binding.numbers.state, exogenous, binding.numbers.params
    )
    assert not np.allclose(varied, nominal, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("simulation", [{}, AT_100_HZ], ids=["continuous", "sampled"])
def test_the_observers_model_can_vary_alone(simulation: dict[str, Any]) -> None:
    """Its model, not the plant, nor the controller and the feedforward."""
    ensemble = {"observer.model.A[1,0]": uniform(-1.5, -1.5)}
    problem = resolve_scenario(scene(ensemble=ensemble, simulation=simulation))
    loop = prepare(problem)[0]
    _, params = bind_ensemble(problem, loop).numbers.pack_lane(np.array([-1.5]))
    model = {"A": [[0.0, 1.0], [-1.5, -2.0]]}
    varied = resolve_scenario(scene(model=model, simulation=simulation)).model.params
    expected = loop.params._replace(observer=loop.params.observer._replace(model=varied))
    np.testing.assert_allclose(params, tree.pack_tree(expected), rtol=1e-13, atol=1e-16)


@pytest.mark.parametrize("method", ["kalman", "censored"])
def test_the_belief_of_a_filter_starts_where_the_run_says(method: str) -> None:
    changes = {
        "simulation": AT_100_HZ,
        "observer": {"method": method, "right": [0.0, 2.0], "noise": 0.1},
    }
    binding = bound({"observer.mean[2]": uniform(0.3, 0.3)}, **changes)
    state, _ = binding.numbers.pack_lane(np.array([0.3]))
    assert state[2 + 2] == 0.3
    levels = {"kalman": 1, "censored": 3}[method]
    assert np.count_nonzero(state != binding.numbers.state) == levels


CENSORED = {"right": [0.0, 2.0], "noise": 0.1, "bias": 1.0, "tolerance": 0.1, "disturbance": 0.1}
OBSERVERS: list[tuple[dict[str, Any], dict[str, Any]]] = [
    (OBSERVER | {"adaptation": {"method": "least_squares"}}, {}),
    (OBSERVER | {"adaptation": {"method": "least_squares"}}, AT_100_HZ),
    ({"method": "oracle"}, {}),
    ({"method": "luenberger", "L": [1.0, 1.0]}, AT_100_HZ),
    ({"method": "high_gain"}, {}),
    ({"method": "super_twisting"}, {}),
    ({"method": "walcott_zak"}, {}),
    ({"method": "ekf", "right": [0.0, 2.0]}, AT_100_HZ),
    ({"method": "ukf", "right": [0.0, 2.0]}, AT_100_HZ),
    ({"method": "printed", "L": [12.0, 15.0], "widths0": 1.0}, {}),
    ({"method": "kalman", "right": [0.0, 2.0]}, AT_100_HZ),
    ({"method": "censored"} | CENSORED, AT_100_HZ),
]


@pytest.mark.parametrize(
    ("observer", "simulation"), OBSERVERS, ids=[case[0]["method"] for case in OBSERVERS]
)
def test_initial_states_are_constants_or_copies_of_params(
    observer: dict[str, Any], simulation: dict[str, Any]
) -> None:
    """`init` on other params gives the state in which just the copies have changed."""
    problem = resolve_scenario(scene(observer=observer, simulation=simulation))
    loop = prepare(problem)[0]
    other_leaves = [np.asarray(leaf) + 0.125 for _, leaf in tree.iterate_leaves(loop.params)]
    other = tree.rebuild_tree(loop.params, iter(other_leaves))
    state = loop.state._replace(
        observer=problem.observer.init(other.observer),
        controller=problem.controller.init(other.controller),
    )
    expected, moved = tree.pack_tree(loop.state), tree.pack_tree(other)
    for entry, source in initial_copies(problem, loop):
        expected[entry] = moved[source]
    assert np.array_equal(tree.pack_tree(state), expected)


# --- addresses of several entries ---


def test_without_an_index_each_entry_has_its_own_draw() -> None:
    entries = {
        "sensor.right": uniform(),
        "sensor.left": uniform(shared=True),
        "plant.A[1,:]": uniform(),
    }
    binding = bound(entries, **TWO)
    right = ["sensor.right[0]", "sensor.right[1]"]
    assert binding.names_of_columns == [*right, "sensor.left", "plant.A[1,0]", "plant.A[1,1]"]
    values = binding.draw_columns(0, 3, 3)
    assert len(np.unique(values)) == values.size
    names = tree.number_addresses(prepare(resolve_scenario(scene(**TWO)))[0].params)
    for row in values:
        params = dict(zip(names, binding.numbers.pack_lane(row)[1], strict=True))
        assert [params[name] for name in right] == row[:2].tolist()
        assert params["sensor.left[0]"] == params["sensor.left[1]"] == row[2]


@pytest.mark.parametrize("simulation", [{}, AT_100_HZ], ids=["continuous", "sampled"])
def test_a_mass_divides_an_equation(simulation: dict[str, Any]) -> None:
    entries = {"plant.A[1, :] + plant.B[1,:]": uniform(0.5, 0.5, relative=True, shared=True)}
    binding = bound(entries, simulation=simulation)
    assert binding.names_of_columns == ["plant.A[1,:] + plant.B[1,:] (relative)"]
    plant = PLANT | tables_of("""
        A = [[0.0, 1.0], [-0.5, -1.0]]
        B = [[0.0], [0.5]]
        """)
    heavy = resolve_scenario(scene(plant=plant, model=MODEL, simulation=simulation))
    _, params = binding.numbers.pack_lane(np.array([0.5]))
    expected = tree.pack_tree(prepare(heavy)[0].params)
    np.testing.assert_allclose(params, expected, rtol=1e-13, atol=1e-16)


def test_factors_leave_entries_that_are_zero_alone() -> None:
    binding = bound({"plant.A": {"normal": [1.0, 0.1], "relative": True}})
    assert binding.names_of_columns == [
        f"plant.A[{index}] (relative)" for index in ("1,0", "0,1", "1,1")
    ]
    values = binding.draw_columns(0, 4, 4)
    np.testing.assert_array_equal(
        binding.numbers.to_lanes(values).params, values * [-1.0, 1.0, -2.0]
    )


@pytest.mark.parametrize(
    ("address", "names"),
    [
        ("plant.A", ["plant.A[0,0]", "plant.A[1,0]", "plant.A[1,1]"]),
        ("plant.A[1,:]", ["plant.A[1,0]", "plant.A[1,1]"]),
        ("plant.A[:,0]", ["plant.A[0,0]", "plant.A[1,0]"]),
        ("plant.A[1,0]", ["plant.A[1,0]"]),
        ("plant", []),
        ("plantXA", []),
        ("observer.gamma", ["observer.gamma"]),
    ],
)
def test_an_address_stands_for_names(address: str, names: list[str]) -> None:
    known = ["plant.A[0,0]", "plant.A[1,0]", "plant.A[1,1]", "observer.gamma"]
    assert matching(address, known) == names


@pytest.mark.parametrize(
    ("signal", "sizes_of_two"),
    [
        (Sine(amplitude=2.0, frequency=1.0), [2.0, 2.0]),
        (Sine(amplitude=2.0, frequency=1.0, offset=0.1), []),
        (Step(amplitude=[2.0, 3.0]), [2.0, 3.0]),
        (Step(amplitude=2.0, before=1.0), []),
        (Random(rms=[0.5, 0.0], correlation_time=0.1), [0.5, 0.0]),
        (None, []),
    ],
)
def test_sizes_that_a_signal_is_proportional_to(signal: Any, sizes_of_two: list[float]) -> None:
    assert channel_amplitudes(signal, 2).tolist() == sizes_of_two


def test_nothing_varies_in_an_empty_table() -> None:
    """Only the noise does."""
    binding = bound({}, {"runs": 5})
    lanes = binding.numbers.to_lanes(binding.draw_columns(0, 5, 5))
    assert (binding.names_of_columns, binding.numbers.indices, lanes.params.shape) == (
        [],
        (),
        (5, 0),
    )
    assert np.array_equal(lanes.states, np.tile(binding.numbers.state, (5, 1)))


# --- distributions ---

LAWS: list[tuple[dict[str, Any], Any]] = [
    ({"uniform": [0.3, 2.0]}, stats.uniform(0.3, 1.7)),
    ({"normal": [1.0, 0.1]}, stats.truncnorm(-10, np.inf, 1.0, 0.1)),
    ({"normal": [0.1, 0.2]}, stats.truncnorm(-0.5, np.inf, 0.1, 0.2)),
    ({"log_normal": [0.5, 0.7]}, stats.lognorm(0.7, scale=0.5)),
]


@pytest.mark.parametrize("sampling", ["random", "latin_hypercube", "sobol", "saltelli"])
@pytest.mark.parametrize(
    ("words", "law"), LAWS, ids=lambda case: str(case) if isinstance(case, dict) else ""
)
def test_draws_follow_their_distribution(words: dict[str, Any], law: Any, sampling: str) -> None:
    binding = bound({"sensor.right": words}, {"sampling": sampling, "seed": 4})
    values = binding.draw_columns(0, 6000, 6000)[:, 0]
    assert values.min() >= 0
    assert stats.kstest(values, law.cdf).pvalue > 1e-3


def test_quantiles_are_accurate_in_the_tails() -> None:
    u = np.array([1e-12, 1e-6, 0.5, 1 - 1e-6])
    for words, law in LAWS:
        distribution = spread("sensor.right", Distribution(**words), 0.0)
        np.testing.assert_allclose(distribution.quantile(u), law.ppf(u), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("kind", ["uniform", "normal"])
def test_a_distribution_without_width_is_its_value(kind: str) -> None:
    words = {"uniform": [0.7, 0.7], "normal": [0.7, 0.0]}[kind]
    values = bound({"sensor.right": {kind: words}}).draw_columns(0, 10, 10)
    assert (values == 0.7).all()


def test_the_seed_is_that_of_the_simulation_unless_given() -> None:
    def drawn(ensemble: dict[str, Any]) -> Floats:
        return bound({"sensor.right": uniform()}, ensemble, simulation={"seed": 5}).draw_columns(
            0, 3, 3
        )

    assert np.array_equal(drawn({}), drawn({"seed": 5}))
    assert not np.array_equal(drawn({}), drawn({"seed": 6}))


# --- a run's numbers do not depend on the batch ---

MANY = {
    "sensor.right": uniform(),
    "sensor.noise": {"log_normal": [0.01, 0.5]},
    "plant.A[1,:]": {"normal": [1.0, 0.3], "relative": True},
    "plant.B[1,0]": {"log_normal": [1.0, 3.0]},
    "plant.x0": {"normal": [0.0, 1.0]},
    "observer.right0": uniform(),
}
BOUND = {
    sampling: bound(MANY, {"sampling": sampling}, simulation=AT_100_HZ)
    for sampling in ("random", "latin_hypercube", "sobol", "saltelli")
}


@pytest.mark.parametrize("sampling", list(BOUND))
@settings(max_examples=30, deadline=None)
@given(first=st.integers(0, 999), count=st.integers(1, 300))
def test_blocks_do_not_matter_to_the_last_bit(sampling: str, first: int, count: int) -> None:
    binding, runs = BOUND[sampling], 1000
    count = min(count, runs - first)
    values = binding.draw_columns(first, count, runs)
    assert np.array_equal(values, binding.draw_columns(0, runs, runs)[first : first + count])
    lanes = binding.numbers.to_lanes(values)
    for k in (0, count // 2, count - 1):
        state, params = binding.numbers.pack_lane(values[k])
        assert np.array_equal(state, lanes.states[k])
        assert np.array_equal(params[list(binding.numbers.indices)], lanes.params[k])


# --- the hold of many plants ---


def discretise(AB: Floats, Ts: float) -> Floats:
    """[Ad, Bd] of many plants (plants x n x (n + m)) from their [A, B]."""
    plants_last = np.ascontiguousarray(np.moveaxis(AB, 0, -1))
    return np.moveaxis(hold.zoh_of_each(plants_last, Ts), -1, 0)


@settings(max_examples=40, deadline=None)
@given(
    seed=seeds,
    n=st.integers(1, 6),
    m=st.integers(1, 2),
    scale=st.sampled_from([1e-6, 1e-2, 1.0, 10.0]),
)
def test_many_plants_are_discretised_like_one(seed: int, n: int, m: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    plants = [random_plant(rng, n, m) for _ in range(5)]
    found = discretise(np.stack([np.hstack(plant.linear[:2]) for plant in plants]), scale)
    for plant, AB in zip(plants, found, strict=True):
        expected = sample_plant(plant, scale).linear
        both = np.hstack([expected.A, expected.B])
        np.testing.assert_allclose(AB, both, rtol=0, atol=1e-13 * max(1.0, np.abs(both).max()))


def test_the_hold_is_exact_to_rounding_where_it_is_known() -> None:
    """An integrator chain, an oscillator at 1e4 rad/s, a fast pole.

    The change of a slow state keeps its digits.
    """
    Ts, w, a = 1e-3, 1e4, 5e3
    chain = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    wave = np.array([[0.0, w, 0.0], [-w, 0.0, w]])
    decay = np.array([[-a, 0.0, a], [0.0, -1e-9, 1e-9]])
    found = discretise(np.stack([chain, wave, decay]), Ts)
    c, s = np.cos(w * Ts), np.sin(w * Ts)
    np.testing.assert_array_equal(found[0], [[1.0, Ts, Ts**2 / 2], [0.0, 1.0, Ts]])
    np.testing.assert_allclose(found[1], [[c, s, 1 - c], [-s, c, s]], atol=1e-13)
    fast = [np.exp(-a * Ts), 0, -np.expm1(-a * Ts)]
    slow = [0, np.exp(-1e-9 * Ts), -np.expm1(-1e-9 * Ts)]
    np.testing.assert_allclose(found[2], [fast, slow], rtol=1e-13)


def test_a_plant_that_overflows_says_so_by_its_numbers() -> None:
    found = discretise(np.array([[[1e6, 1.0]], [[-1.0, 1.0]]]), 1.0)
    assert not np.isfinite(found[0]).all()
    np.testing.assert_allclose(found[1], [[np.exp(-1.0), -np.expm1(-1.0)]], rtol=1e-15)


# --- tables ---


def test_toml_and_python_use_the_same_words() -> None:
    text = """
        [ensemble]
        runs = 7
        sampling = "sobol"
        "sensor.right" = { uniform = [0.3, 2.0] }
        [ensemble.entries]
        "plant.A[1,0]" = { normal = [1, 0.1], relative = true }
    """
    entries = {
        "plant.A[1,0]": Distribution(normal=(1.0, 0.1), relative=True),
        "sensor.right": Distribution(uniform=(0.3, 2.0)),
    }
    expected = Vary(runs=7, sampling="sobol", entries=entries)
    data = table() | {"ensemble": parse_table(text)}
    assert convert(data).ensemble == expected
    twice = TABLE.decode_table(TABLE.decode_table(data["ensemble"]))
    assert convert(table() | {"ensemble": twice}).ensemble == expected


def parse_table(text: str) -> Any:
    import tomllib

    return tomllib.loads(text)["ensemble"]


def test_unquoted_addresses_in_a_file() -> None:
    with pytest.raises(InputError, match="An address stands in quotes"):
        parse("[ensemble]\nsensor.right = { uniform = [0.3, 2.0] }")


ADDRESSES = ["sensor.right", "sensor.left[0]", "plant.A[1,:]", "plant.A", "plant.B[1,0] + plant.A"]
ADDRESSES += ["disturbance.amplitude", "."]
NUMBERS = [0, 1, 1.0, -1.0, 0.3, 1e-320, 1e49, 1e60, 2**62, True, "1"]
addresses = st.sampled_from(ADDRESSES) | st.text(max_size=4)
numbers = st.sampled_from(NUMBERS) | st.floats()
pairs = st.lists(numbers, min_size=2, max_size=2)
words_of_distribution = {
    "uniform": pairs | numbers,
    "normal": pairs | numbers,
    "log_normal": pairs | numbers,
    "relative": st.booleans(),
    "shared": st.booleans() | numbers,
}
values = st.fixed_dictionaries({}, optional=words_of_distribution)
words_of_table = {
    "runs": numbers,
    "seed": numbers,
    "tolerance": numbers,
    "entries": st.dictionaries(addresses, values, max_size=2) | numbers,
}
tables = st.fixed_dictionaries({}, optional=words_of_table)


@settings(max_examples=300, deadline=None)
@given(reserved=tables, entries=st.dictionaries(addresses, values | numbers, max_size=3))
def test_only_undeadzone_errors_come_out_of_any_table(
    reserved: dict[str, Any], entries: dict[str, Any]
) -> None:
    with suppress(UndeadzoneError):
        scenario = convert(table(simulation=AT_100_HZ) | {"ensemble": entries | reserved})
        binding = bind_ensemble(NOMINAL._replace(scenario=scenario), prepare(NOMINAL)[0])
        with np.errstate(all="ignore"):
            binding.numbers.to_lanes(binding.draw_columns(0, 3, 3))


NOMINAL = resolve_scenario(scene(simulation=AT_100_HZ))


def test_a_scenario_without_the_table() -> None:
    problem = resolve_scenario(scene())
    with pytest.raises(InputError, match=r"ensemble: missing. Add a table \[ensemble\]"):
        bind_ensemble(problem, prepare(problem)[0])


@pytest.mark.parametrize("pair", [None, (1.0,), (1.0, float("nan")), ("a", 1.0), 3.0])
def test_values_from_python_are_validated_too(pair: Any) -> None:
    with pytest.raises(InputError, match=r"sensor\.right"):
        spread("sensor.right", Distribution(uniform=pair), 0.0)
