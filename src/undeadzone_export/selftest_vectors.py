"""Self-test: inputs of the scenario's own run, the expected bits, and the C that compares."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

import undeadzone
from undeadzone.compile.numpy_reference import reference_evaluator
from undeadzone.compile.scalar_step import CompiledStepper
from undeadzone.errors import InputError
from undeadzone.nonlinearities.sensor import branch, zone
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.signals.noise import stationary_first_order_noise
from undeadzone.simulation.simulate import name_outputs, prepare
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone_export.code import Code
from undeadzone_export.exported_step import ExportedStep, member_entries, name_entries
from undeadzone_export.template import call_words, fill_template

DIVERGED = 1e6  # size of a signal beyond which a run is not used
PIECE = 512  # samples of a run between two looks for its divergence
SAMPLES = 96  # of a run, in the self-test
NAN = {"float32": 0x7FC00000, "float64": 0x7FF8000000000000}  # the bits of every NaN
# Drawn readings of a signal: its rms [widest edge], and its correlation time [samples].
WIDE = 3.0
SLOW = 20.0
# of the checksum by Fowler, Noll and Vo, 32 bits
OFFSET = 2166136261
PRIME = 16777619


class Vectors(NamedTuple):
    """Reference vectors of the self-test, as bits.

    Attributes:
        inputs: words of each sample's inputs (samples x inputs).
        outputs: words of each sample's outputs (samples x outputs).
        states: checksum of the memory after each sample (samples).
    """

    inputs: Any
    outputs: Any
    states: list[int]


def continue_scenario(scenario: Scenario, steps: int) -> Problem:
    """Return the checked parts of a scenario whose run has at least a number of steps.

    If it cannot be continued, as with a signal from a file that ends, it is the scenario itself.
    """
    simulation = scenario.simulation
    duration = max(simulation.duration, steps * simulation.step)
    try:
        return resolve_scenario(scenario.replace("simulation.duration", duration))
    except InputError:
        return resolve_scenario(scenario)


def record_inputs(problem: Problem, step: ExportedStep) -> Floats:
    """Record the inputs of a step along a run, up to its divergence.

    A signal has no run: its readings are drawn (`draw_readings`).

    Args:
        problem: the checked parts of a sampled scenario.
        step: the step. It determines if u or the target of the controller is an input.

    Returns:
        A row of readings, then of the other inputs, for each sample.

    Raises:
        InputError: it diverges at once.
    """
    if not problem.model.m:
        return draw_readings(problem)
    loop, state, exogenous = prepare(problem)
    stepper = CompiledStepper(loop.step, state, tree.pack_tree(loop.params), brief=True)
    places = tree.leaf_slices(loop.instant).target
    found = []
    for given in np.split(exogenous, range(PIECE, len(exogenous), PIECE)):
        signals = name_outputs(loop, stepper.run(given))
        others = [signals.u] if step.acting else [given[:, place] for place in places]
        rows = np.hstack([signals.y, *others])
        if problem.levels is not None:
            rows = rows + step.at_rest
        is_absent = np.isnan(rows) & (np.arange(rows.shape[1]) >= step.readings)
        diverged = np.flatnonzero((is_absent | (np.abs(rows) > DIVERGED)).any(axis=1))
        found.append(rows[: diverged[0]] if diverged.size else rows)
        if diverged.size:
            break
    if not found[0].size:
        raise InputError(
            f"simulation: the run leaves +-{DIVERGED:g} at its first sample, so there is nothing "
            "to measure the code on. Export a scenario whose run stays bounded"
        )
    return np.concatenate(found)


def draw_readings(problem: Problem) -> Floats:
    """Return readings of a coloured signal that is often outside the zone (samples x 1).

    Args:
        problem: the checked parts of the scenario of a signal.
    """
    sensor = problem.sensor
    simulation = problem.scenario.simulation
    rms = WIDE * np.maximum(sensor.widest, sensor.noise + sensor.noise_before)
    shape = problem.steps + 1, rms, SLOW * simulation.step, simulation.step
    z = stationary_first_order_noise(simulation.seed, *shape)
    edges = sensor.right, sensor.left
    y = branch(z, zone(z, *edges), *edges, sensor.slope, sensor.kind)
    return y if problem.levels is None else y + problem.levels.y


def choose_samples(rows: Floats, readings: int) -> Floats:
    """Choose samples for the self-test: some of a run, missing values, and extreme readings.

    Args:
        rows: the inputs along a run.
        readings: number of columns that are readings. They come first.
    """
    picked = rows[np.linspace(0, len(rows) - 1, min(SAMPLES, len(rows))).astype(int)].copy()
    outputs = np.arange(readings)
    picked[(7 + 11 * outputs) % len(picked), outputs] = np.nan
    seen = np.abs(np.nan_to_num(rows[:, :readings]))
    size = np.maximum(seen.max(axis=0), 1.0)
    extremes = np.repeat(picked[-1:], 4, axis=0)
    extremes[:, :readings] = np.outer([3.0, -3.0, 0.0, 1e-3], size)
    return np.vstack([picked, extremes, picked[:8]])


def reference_vectors(code: Code, rows: Floats) -> Vectors:
    """Compute the bits of outputs and memory along inputs, without a compiler.

    Args:
        code: the printed nodes.
        rows: inputs, a row for each sample.
    """
    kind = code.dtype_name
    evaluate = reference_evaluator(code.results, code.parts)
    rows = rows.astype(kind)
    state = code.step.start.astype(kind)
    params = code.step.defaults.astype(kind)
    outputs = []
    states = []
    with np.errstate(all="ignore"):
        for row in rows:
            following, out = evaluate(name_entries(s=state, w=row, p=params))
            state = np.array(following, kind)
            outputs.append(np.array(out, kind))
            states.append(bit_checksum(state, kind))
    table = np.array(outputs).reshape(len(rows), len(member_entries(code.step.outputs)))
    return Vectors(bit_words(rows, kind), bit_words(table, kind), states)


def bit_words(values: Any, kind: str) -> Any:
    """Return the bits of numbers. All NaN have the same bits."""
    table = np.ascontiguousarray(values, kind)
    bits = table.view(f"uint{8 * table.itemsize}").copy()
    bits[np.isnan(table)] = NAN[kind]
    return bits


def bit_checksum(values: Any, kind: str) -> int:
    """Return the checksum of the bits of numbers, 32 bits at a time, lower bits first."""
    total = OFFSET
    bits = bit_words(values, kind)
    for word in bits.astype(bits.dtype.newbyteorder("<")).view("<u4").tolist():
        total = ((total ^ word) * PRIME) & 0xFFFFFFFF
    return total


def selftest_source(code: Code, prefix: str, vectors: Vectors) -> str:
    """Return the C source of the self-test.

    Args:
        code: the printed nodes.
        prefix: what every symbol begins with.
        vectors: the reference vectors.
    """
    digits, ending = (8, "u") if code.single else (16, "ull")
    words = call_words(prefix, bool(code.step.params)) | {
        "version": undeadzone.__version__,
        "samples": len(vectors.states),
        "inputs": vectors.inputs.shape[1],
        "outputs": vectors.outputs.shape[1],
        "memory": code.step.start.size,
        "real": code.c_type,
        "word": f"uint{4 * digits}_t",
        "is_double": not code.single,
        "magnitude": "0x7fffffffu" if code.single else "0x7fffffffffffffffull",
        "infinity": "0x7f800000u" if code.single else "0x7ff0000000000000ull",
        "nan": f"0x{NAN[code.dtype_name]:x}{ending}",
        "offset": OFFSET,
        "prime": PRIME,
        "phased": code.phases is not None,
        "input_words": _rows_in_braces(vectors.inputs.tolist(), digits, ending),
        "output_words": _rows_in_braces(vectors.outputs.tolist(), digits, ending),
        "state_words": _hex_lines(vectors.states, 8, "u"),
    }
    return fill_template("templates/selftest.c", words)


def _rows_in_braces(rows: list[list[int]], digits: int, ending: str) -> str:
    """Return rows of words in braces."""
    return ",\n".join("{\n" + _hex_lines(row, digits, ending) + "\n}" for row in rows)


def _hex_lines(numbers: list[int], digits: int, ending: str) -> str:
    """Return words in lines of up to eight."""
    texts = [f"0x{number:0{digits}x}{ending}" for number in numbers]
    count = 64 // digits
    rows = [texts[start : start + count] for start in range(0, len(texts), count)]
    return ",\n".join("    " + ", ".join(row) for row in rows)
