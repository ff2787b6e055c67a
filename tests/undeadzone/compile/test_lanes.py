"""What the lanes engine does for ensembles.

Steps in parts, inputs that are supplied or known, every so many-th output.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_engines import BOTH, WIDTHS, distance, identical, parts, shocks, small

from documents import EXAMPLES
from undeadzone.compile import lanes
from undeadzone.errors import InputError
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.simulation.simulate import prepare
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone_studies.ensemble.result import Ensemble


def test_a_step_in_parts_is_the_whole_step_to_the_last_bit() -> None:
    loop, state, exogenous = prepare(resolve_scenario(small()))
    assert loop.parts is not None
    states = np.tile(state, (WIDTHS.size, 1))
    states[:, 0] += WIDTHS
    run = (states, exogenous, tree.pack_tree(loop.params))
    in_parts = lanes.run_lanes(lanes.build_kernel(*loop.parts, width=16), *run)
    whole = lanes.run_lanes(lanes.build_kernel(loop.step, width=16), *run)
    assert all(map(identical, in_parts, whole))
    side = in_parts[0][:, :, tree.number_addresses(loop.outputs).index("side[0]")]
    crossing = (side != side[:, :1]).argmax(axis=1)
    assert np.unique(crossing).size > 3  # lanes cross at different steps


@pytest.mark.parametrize("buffer", [1, lanes.BUFFER])
def test_every_so_many_th_output_is_one_of_all(
    buffer: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lanes, "BUFFER", buffer)
    step, state, exogenous, params, _ = parts(small("sampled"))
    kernel = lanes.build_kernel(step, width=8)
    outputs, finals = lanes.run_lanes(kernel, np.tile(state, (3, 1)), exogenous, params)
    for every in (7, 300, 1000):
        chosen, same = lanes.run_lanes(
            kernel, np.tile(state, (3, 1)), exogenous, params, every=every
        )
        assert identical(chosen, outputs[:, ::every])
        assert identical(same, finals)


def test_inputs_may_be_supplied_as_they_are_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    step, state, exogenous, params, _ = parts(small("sampled"))
    kernel = lanes.build_kernel(step, exogenous=[5, 3], record=[0, 4], width=8)
    inputs = shocks(len(exogenous))
    expected = lanes.run_lanes(kernel, state, exogenous, params, inputs)
    requested: list[tuple[int, int, int]] = []

    def supply(chosen: Any) -> Callable[[int, int], Floats]:
        def source(first: int, count: int) -> Floats:
            requested.append((int(chosen[0]), first, count))
            return inputs[first : first + count, :, chosen]

        return source

    monkeypatch.setattr(lanes, "BUFFER", 8 * 2 * 40)
    states = np.tile(state, (WIDTHS.size, 1))
    assert all(map(identical, lanes.run_lanes(kernel, states, exogenous, params, supply), expected))
    in_order = [(k, min(40, 301 - k)) for k in range(0, 301, 40)]
    for lane in (0, 8, 16):
        assert [(first, count) for which, first, count in requested if which == lane] == in_order


@pytest.mark.parametrize("time", BOTH)
def test_what_is_known_changes_numbers_by_rounding_at_most(time: str) -> None:
    simulation = {"duration": 3.0, "step": 1e-2, "switching": "plain"}
    silent = {"noise": 0.0, "noise_before": 0.0}
    scenario = small(time, sensor=silent, simulation=simulation)
    loop, state, exogenous = prepare(resolve_scenario(scenario))
    params = tree.pack_tree(loop.params)
    inputs = {i: 0.0 for i, column in enumerate(exogenous.T) if not column.any()}
    numbers = {i: value for i, value in enumerate(params.tolist()) if value in (0.0, 1.0)}
    assert inputs
    assert numbers
    kernels = [
        lanes.build_kernel(loop.step, width=8),
        lanes.build_kernel(loop.step, width=8, known_exogenous=inputs),
        lanes.build_kernel(loop.step, width=8, known_exogenous=inputs, known_params=numbers),
    ]
    plain, same, close = (lanes.run_lanes(kernel, state, exogenous, params) for kernel in kernels)
    assert all(map(np.array_equal, same, plain))
    assert max(distance(a[0], b[0]) for a, b in zip(close, plain, strict=True)) < 1e-13


def test_entries_that_are_not_there_are_named() -> None:
    step = parts(small("sampled"))[0]
    for name, options in (
        ("exogenous", {"known_exogenous": {99: 0.0}}),
        ("params", {"known_params": {99: 0.0}}),
        ("params", {"params": [-1]}),
    ):
        with pytest.raises(InputError, match=f"^{name}: expected entries from 0 to "):
            lanes.build_kernel(step, **options)


STARTED = """
import sys
from undeadzone.cli import main
try:
    main()
finally:
    print(sorted({"scipy.stats", "matplotlib"} & sys.modules.keys()), file=sys.stderr)
"""


def test_an_ensemble_imports_nothing_heavy_and_a_second_start_has_its_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UNDEADZONE_CACHE", str(tmp_path / "kernels"))
    options = ["--runs", "4", "--no-figures", "--out"]
    text = (EXAMPLES / "ensemble.toml").read_text()
    scenario = tmp_path / "ensemble.toml"  # Sobol points are SciPy's, and late; others are not
    scenario.write_text(text.replace('sampling = "sobol"', 'sampling = "latin_hypercube"'))
    command = [sys.executable, "-c", STARTED, "ensemble", str(scenario), *options]
    imported = []
    for name in "ab":
        process = subprocess.run(
            [*command, str(tmp_path / name)], capture_output=True, text=True, check=True
        )
        imported.append(process.stderr.splitlines()[-1])
    assert imported == ["[]", "[]"]
    first, second = (Ensemble.load(tmp_path / name / "runs.npz").metrics for name in "ab")
    assert all(map(identical, first.values(), second.values()))
