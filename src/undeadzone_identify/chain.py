"""Pipeline from a log's scenario to firmware run along the log: `identify --chain DIR`."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats, to_json_value
from undeadzone.util.files import open_scratch, write_text
from undeadzone.util.text import append_unit

if TYPE_CHECKING:
    from undeadzone.results.estimation import Estimation
    from undeadzone.scenario.schema import Scenario
    from undeadzone_export.code import Code
    from undeadzone_export.snippet import Lost
    from undeadzone_identify.results.loop import IdentifiedLoop
    from undeadzone_identify.results.lost_motion import IdentifiedMotion
    from undeadzone_identify.results.result import Identified


class FirmwareChain(NamedTuple):
    """Results of the steps from the scenario of a log to tested firmware.

    Attributes:
        words: of each step, for printing.
        numbers: for JSON.
        files: those written.
        passed: whether every step was done and nothing was refused.
    """

    words: dict[str, Any]
    numbers: dict[str, Any]
    files: list[Path]
    passed: bool


def run_firmware_chain(
    path: Path, log: Path, folder: Path, columns: str | None, strict: bool, delay: int = 0
) -> FirmwareChain:
    """Check a scenario, estimate along its log, export it to C and run the C along the log.

    Args:
        path: of the scenario.
        log: it was made from.
        folder: where estimate and firmware go.
        columns: which column of the log is which, as `estimate` takes it.
        strict: whether a line of the log that cannot be read is an error.
        delay: samples by which the recording delays the inputs.

    Raises:
        InputError: a step is refused.
    """
    from undeadzone.analysis.identifiability.linear import format_yes_no
    from undeadzone.cli.common import require_writable
    from undeadzone.scenario.problem import resolve_scenario
    from undeadzone.scenario.reader import read
    from undeadzone.simulation.estimate import estimate
    from undeadzone_design.synthesis.assessment import assess_problem
    from undeadzone_export.exporting import export

    scenario = read(path)
    known = assess_problem(resolve_scenario(scenario)).known
    found = estimate(scenario, log, columns=columns, strict=strict, delay=delay)
    kept = found.save(require_writable(folder) / "estimate.npz")
    firmware = export(scenario, "c", folder / "firmware", check=True)
    assert firmware.code is not None
    hidden, left = firmware_errors(scenario, found, firmware.code)
    report = firmware.report
    reasons = report["float_refusals"][:1] + report["refusals"]
    numbers = {
        "identifiable": [one.right and one.left for one in known],
        "consistent": found.consistent,
        "precision": report["precision"],
        "self_test": report["self_test"],
        "refusals": report["refusals"],
        "hidden": hidden,
        "left": left,
    }
    unit = scenario.units.output
    own = "" if found.z_smooth is not None else ", z is the filter's own here: none smooths"
    words = {
        "check": [format_yes_no(msgspec.structs.asdict(one)) for one in known],
        "consistent": {None: "not tested", True: "yes", False: "NO"}[found.consistent],
        "firmware": [f"{report['precision']}: {report['self_test']}", *reasons],
        "reading off": f"rms y - z {append_unit(f'{hidden:.3g}', unit)} along the log",
        "firmware off": f"rms z^ - z {append_unit(f'{left:.3g}', unit)}, z^ by the C there{own}",
    }
    return FirmwareChain(
        words, to_json_value(numbers), [kept, *firmware.files], firmware.has_passed
    )


def find_compensation(numbers: dict[str, Any], source: str) -> Lost | None:
    """Return what a few lines compensate; None if no few lines help or nothing is certain.

    Args:
        numbers: of the answer, as in identify.json.
        source: name of the log, for people.
    """
    from undeadzone_export.snippet import lost_of_answer

    try:
        return lost_of_answer(numbers, source, source)
    except InputError:
        return None


def compensating_lines(numbers: dict[str, Any], source: str) -> dict[str, str]:
    """Return the few lines that compensate the finding, by the names of their files.

    Args:
        numbers: of the answer, as in identify.json.
        source: name of the log, for people.

    Returns:
        C, Python and Structured Text; nothing if no few lines help or nothing is certain.
    """
    from undeadzone_export.snippet import NAMES, snippet_texts

    lost = find_compensation(numbers, source)
    return {} if lost is None else snippet_texts(lost, NAMES[lost.kind])


def command_of_log(answer: Identified | IdentifiedMotion | IdentifiedLoop) -> Floats:
    """Return the signal of a log along which the few lines are run, in their unit (N).

    Args:
        answer: of one log.
    """
    from undeadzone_identify.results.lines import command_along
    from undeadzone_identify.results.loop import IdentifiedLoop
    from undeadzone_identify.results.lost_motion import IdentifiedMotion

    if isinstance(answer, IdentifiedLoop):
        return answer.logs[0].u[:, 0]
    if isinstance(answer, IdentifiedMotion):
        return answer.answer.data.u
    return command_along(answer.answer)


def run_snippet_chain(lost: Lost, signal: Floats, folder: Path) -> FirmwareChain:
    """Write the few lines that need no plant, compile the C and run it along the log.

    Args:
        lost: a gap.
        signal: the command [u] (N).
        folder: where the lines go.

    Raises:
        InputError: there is no compiler.
    """
    from undeadzone_export.compiler import compile_library
    from undeadzone_export.snippet import NAMES, write_lost
    from undeadzone_identify.results.lines import pass_machine

    report = write_lost(lost, folder / "snippet", None, False)
    name = NAMES[lost.kind]
    with open_scratch() as scratch:
        main = scratch / "axis.c"
        called = f"float call(float x);\nfloat call(float x) {{ return {name}(x); }}\n"
        snippet = (folder / "snippet" / "snippet.h").read_text(encoding="utf-8")
        write_text(snippet + called, main)
        call = ctypes.CDLL(str(compile_library([str(main)], scratch / "axis.so"))).call
        call.restype = ctypes.c_float
        call.argtypes = [ctypes.c_float]
        compiled = np.array(list(map(call, signal.tolist())))
    without, reached = (pass_machine(lost, one, 0) for one in (signal, compiled))
    errors = [float(np.abs(one - signal)[1:].max()) for one in (without, reached)]
    texts = [append_unit(f"{one:.3g}", lost.unit) for one in errors]
    words = {
        "firmware": f"{name}() of snippet.h compiles. No plant is needed",
        "axis off": f"up to {texts[0]} of an axis simulated with this gap, {texts[1]} with the C",
    }
    numbers = {"axis_off": errors[0], "axis_off_with_code": errors[1]}
    return FirmwareChain(words, numbers, list(map(Path, report["written"])), True)


def firmware_errors(scenario: Scenario, found: Estimation, code: Code) -> tuple[float, float]:
    """Return the rms errors of the reading and of the exported C's z^ along the log [z].

    The truth is nobody's: z is what the whole log says of it, or the filter where none smooths.

    Args:
        scenario: that was exported.
        found: the estimate along the log.
        code: that was printed of its observer.

    Returns:
        rms of y / m - z, and of the C's z^ - z, over all outputs [z].
    """
    from undeadzone_export.accuracy import CompiledStep
    from undeadzone_export.exported_step import field_slices

    z = found.z_hat if found.z_smooth is None else found.z_smooth
    with open_scratch() as scratch:
        outputs = CompiledStep(code, scratch)(np.hstack([found.y, found.u]))
    estimated = outputs[:, field_slices(code.step.outputs)["z"]]
    return _rms_ignoring_nan(found.y / np.asarray(scenario.sensor.slope) - z), _rms_ignoring_nan(
        estimated - z
    )


def _rms_ignoring_nan(values: Floats) -> float:
    """Return the root mean square of the values, NaN left out."""
    return float(np.sqrt(np.nanmean(values**2)))
