"""Export of a scenario to a folder of C, with a report on cost and accuracy."""

from __future__ import annotations

import itertools
import re
import time
import tomllib
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

import undeadzone
from undeadzone.compile.casadi_reader import count_instructions, read_constants
from undeadzone.compile.graph import required_nodes
from undeadzone.compile.print_c import c_literal
from undeadzone.compile.simplify import round_to_type
from undeadzone.errors import InputError, ProofError
from undeadzone.observers.filtering.prior import widths_within
from undeadzone.registry import OBSERVERS
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.util.arrays import Floats
from undeadzone.util.text import count_noun, suggest_name
from undeadzone_export import accuracy, compiler, exported_step, targets
from undeadzone_export.boards import BoardFit, fit_boards
from undeadzone_export.code import Code, build_code
from undeadzone_export.exported_step import ExportedStep, Field, to_identifier, total_size
from undeadzone_export.fmu.package import require_buildable
from undeadzone_export.page.build import write_live_page
from undeadzone_export.proving import FILE, proof_text, propose_sampled
from undeadzone_export.selftest_vectors import (
    choose_samples,
    continue_scenario,
    record_inputs,
    reference_vectors,
)
from undeadzone_export.source import Labels, Source, build_source
from undeadzone_export.targets import Material

PRECISIONS = ("single", "double")
FIRMWARE = ("c", "arduino")  # targets whose boards matter
WITH_PROOF = ("c", "arduino", "python")  # targets whose folder has the C
ELSEWHERE = ("arduino", "st")  # targets whose self-test runs on the target alone
MANY = 20_000  # instructions of which an export takes a minute on a busy machine
EACH = 1e-3  # of the processor's time that an export takes for each of them [s]
STEPS = 100_000  # of the comparison of float with double, at least
NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")


class Exported(NamedTuple):
    """Files and report of an export.

    Attributes:
        files: the files written (none if the export is refused).
        report: name, hash, sizes and the stack on this computer [bytes], operations of a step,
            accuracy, why float was not taken, and `refusals`: why nothing is written, with the
            number (empty if all is well).
        code: the printed nodes (None for a page).
    """

    files: list[Path]
    report: dict[str, Any]
    code: Code | None = None

    @property
    def has_passed(self) -> bool:
        """Return whether the export has no refusals."""
        return not self.report["refusals"]


class _Draft(NamedTuple):
    """Code of a scenario in a precision, before it is written.

    Attributes:
        problem: the checked parts of the scenario.
        step: of the observer.
        printed: the nodes.
        text: the C.
        rows: inputs of the step along the scenario's own run, continued.
        report: on cost and accuracy.
    """

    problem: Problem
    step: ExportedStep
    printed: Code
    text: Source
    rows: Floats
    report: dict[str, Any]


def export(
    scenario: Scenario,
    to: str = "c",
    out: str | Path = "firmware",
    precision: str | None = None,
    part: str = "observer",
    tunable: tuple[str, ...] = (),
    name: str | None = None,
    check: bool = False,
    force: bool = False,
    notify: Callable[[str], object] | None = None,
    method: str | None = None,
) -> Exported:
    """Write a scenario's observer as C99 that runs without a library.

    Args:
        scenario: a scenario with simulation.time = "sampled".
        to: "c", "arduino" for a library of the Arduino IDE, "st" for Structured Text of IEC
            61131-3, "fmu2" or "fmu3" for an FMU for co-simulation, "python" for a module that needs
            no undeadzone, or "page" for one HTML file in which the scenario's loop runs.
        out: folder for the files, or the HTML file (replaced if it is an earlier export). Other
            files in the folder stay.
        precision: "single" for float, or "double" (default: double, but for "c", "arduino" and
            "st" float where it is accurate enough).
        part: "observer", or "observer+controller".
        tunable: numbers that stay parameters of the code, such as "observer.gamma".
        name: first part of every symbol (default: made of the scenario's title).
        check: also build the self-test with this computer's compiler and run it (not for Arduino
            and Structured Text).
        force: replace files that someone else wrote or edited, if they are in the way (other files
            stay).
        notify: called with a sentence before something that takes minutes begins.
        method: another observer for this export, such as "kalman", or with values of its keys
            "contact starts=1". Keys that it does not have are dropped.

    Returns:
        The files, and a report. Accuracy is measured if there is a C compiler. Single precision
        that was asked for and was not measured counts as refused.

    Raises:
        InputError: a scenario that cannot be exported, or an unknown option.
        FileError: the folder is something else, or cannot be written.

    Example:
        >>> first_order = uz.Scenario(
        ...     plant=uz.Plant(A=[[-1.0]], B=[1.0], C=[1.0]),
        ...     sensor=sensor,
        ...     reference=reference,
        ...     observer=uz.Certified(L=[1.0], gamma=2.0),
        ...     simulation=simulation,
        ... )
        >>> exported = uz.export(first_order, "c", out=folder / "firmware")
        >>> (folder / "firmware" / "README.md").exists()
        True

    See Also:
        Online, simulate
    """
    _require_known_word("to", to, tuple(targets.PRECISION))
    least = PRECISIONS.index(targets.PRECISION[to])
    precisions = PRECISIONS[least:] if precision is None else (precision,)
    _require_known_word("precision", precisions[0], PRECISIONS)
    tunable = tuple(dict.fromkeys(tunable))
    scenario, dropped = (scenario, []) if method is None else change_method(scenario, method)
    if to == "page":
        _require_page_options(precisions[0], part, tunable, name, check)
        report = write_live_page(scenario, Path(out), force)
        return Exported([Path(out)], report | {"dropped": dropped})
    labels = Labels(_symbol_prefix(name, scenario.title), scenario.title, part)
    targets.require_replaceable(Path(out), force)
    if to in targets.VERSIONS:
        require_buildable(labels.prefix, targets.VERSIONS[to])
    draft = _draft_code(scenario, labels, precisions, tunable, notify)
    report = draft.report | {"dropped": dropped}
    if to in FIRMWARE and not report["refusals"]:
        found = _boards_of(draft)
        report["boards"] = [fit._asdict() for fit in found]
        if not all(fit.fits for fit in found):
            report["leaner"] = _fit_leaner(scenario, labels, precisions, found)
    samples = choose_samples(draft.rows[: draft.problem.steps + 1], draft.step.readings)
    vectors = reference_vectors(draft.printed, samples)
    proof, report["proof"] = _prove_draft(draft, to, labels.part, tunable)
    material = Material(draft.printed, labels, draft.text, vectors, scenario.units, report, proof)
    if check and to not in ELSEWHERE:
        passed, report["self_test"] = compiler.run_selftest(material.c_files)
        if not passed:
            report["refusals"].append(f"the self-test fails: {report['self_test']}")
    written = []
    if not report["refusals"]:
        written = targets.write_folder(targets.export_files(to, material), Path(out), force)
    return Exported(written, report, draft.printed)


def _prove_draft(
    draft: _Draft, to: str, part: str, tunable: tuple[str, ...]
) -> tuple[targets.Files, str | None]:
    """Return the proof about the C of a certified observer by file name, and its statement.

    Without a proof the reason takes the place of the statement. Other code has neither.
    """
    tag = draft.problem.scenario.observer.__struct_config__.tag
    if tag != "certified" or tunable or part != "observer" or to not in WITH_PROOF:
        return {}, None
    try:
        proof = propose_sampled(draft.problem, draft.text, draft.printed.single)
    except (InputError, ProofError) as error:
        return {}, f"none, {error}"
    del proof["source"]["texts"]
    return {FILE: proof_text(proof)}, str(proof["statement"])


def _draft_code(
    scenario: Scenario,
    labels: Labels,
    precisions: Sequence[str],
    tunable: tuple[str, ...] = (),
    notify: Callable[[str], object] | None = None,
) -> _Draft:
    """Build the code of a scenario in the first precision that is accurate enough.

    Args:
        scenario: the scenario.
        labels: the words that the files share.
        precisions: from which the first is taken that is not refused, or else the last.
        tunable: numbers that stay parameters.
        notify: called with a sentence before something that takes minutes begins.
    """
    problem = resolve_scenario(scenario)
    began, spent = time.monotonic(), time.process_time()
    step = exported_step.build_step(problem, labels.part, tunable)
    if notify is not None and (instructions := count_instructions(step.function)) > MANY:
        waiting = (time.monotonic() - began) / (time.process_time() - spent)  # for the processor
        seconds = EACH * instructions * max(1.0, waiting)
        notify(_slow_export_warning(instructions, seconds, scenario.observer))
    steps = STEPS if "single" in precisions else accuracy.MACHINE_STEPS
    rows = record_inputs(continue_scenario(scenario, steps), step)
    too_coarse: list[str] = []
    for precision in precisions:
        printed = build_code(step, single=precision == "single")
        text = build_source(printed, labels)
        report = _initial_report(printed, text, labels, tunable)
        report["replaced_constants"] = constants_beyond_float(printed) if printed.single else []
        report |= _accuracy_report(printed, text, rows) | {"float_refusals": too_coarse}
        if not report["refusals"]:
            break
        too_coarse = report["refusals"]
    if printed.single:
        report["refusals"] = [f"{one}; use --precision double" for one in report["refusals"]]
    return _Draft(problem, step, printed, text, rows, report)


def _slow_export_warning(instructions: int, seconds: float, observer: Any) -> str:
    """Return a warning about a long export, with cheaper choices.

    Args:
        instructions: number of instructions of a step's graph.
        seconds: that the export will take, estimated [s].
        observer: the options of the observer.
    """
    minutes = count_noun(max(1, round(seconds / 60)), "minute")
    message = (
        f"{instructions:,} instructions, which take about {minutes} to write, compile and compare"
    )
    less = " or ".join(f"--method {name!r}" for name in _leaner_methods(observer))
    return message + f"; {less} takes less" * bool(less)


def _leaner_methods(observer: Any) -> list[str]:
    """Return observers with fewer operations, as `change_method` takes them.

    Some scenarios refuse some of them.
    """
    own = observer.__struct_config__.tag
    if hasattr(observer, "starts"):
        return [f"{own} starts=1"] * (observer.starts > 1)
    ordered = ["kalman", "certified"]
    return ordered[ordered.index(own) + 1 :] if own in ordered else ordered


def change_method(scenario: Scenario, method: str) -> tuple[Scenario, list[str]]:
    """Return a scenario with another observer, and the given keys that this does not have.

    An rms of a coloured disturbance is none of a white one, so it is not handed on either. Ranges
    of widths become initial widths and their bound for an observer that adapts.

    Args:
        scenario: the scenario.
        method: name of the observer, and values of its keys, such as "contact starts=1".

    Raises:
        InputError: there is no such observer, or it lacks a key that it needs.
    """
    name, _, settings = method.partition(" ")
    observer: Any = scenario.observer
    try:
        changes = tomllib.loads(settings.replace(" ", "\n"))
    except tomllib.TOMLDecodeError:
        raise InputError(f"method: expected NAME or 'NAME KEY=VALUE', found {method!r}") from None
    known = {*getattr(OBSERVERS.find_options(name), "__struct_fields__", ())}
    if "correlation_time" in known ^ {*observer.__struct_fields__}:
        known.discard("disturbance")
    given = {}
    for field in msgspec.structs.fields(observer):
        value = getattr(observer, field.name)
        if np.size(value) and not np.array_equal(value, field.default):
            given[field.name] = value
    if "width_max" in known and "right" in given.keys() - known:
        ranges = given.pop("right"), given.pop("left", None), resolve_scenario(scenario).model.p
        given |= {key: each.tolist() for key, each in widths_within(*ranges).items()}
    table = {"method": name} | {key: given[key] for key in given.keys() & known} | changes
    dropped = [f"observer.{key}" for key in given.keys() - known - changes.keys()]
    return scenario | {"observer": table}, sorted(dropped)


def _require_known_word(key: str, value: str, known: tuple[str, ...]) -> None:
    """Raise InputError for an unknown word."""
    if value not in known:
        raise InputError(
            f"{key}: found {value!r}. {suggest_name(value, known, 'Expected one of', 0.7)}"
        )


def _require_page_options(
    precision: str, part: str, tunable: tuple[str, ...], name: str | None, check: bool
) -> None:
    """Raise InputError for an option that has no meaning for a page."""
    options = {
        "precision": precision != "double",
        "part": part != "observer",
        "tunable": tunable,
        "name": name,
        "check": check,
    }
    for key, value in options.items():
        if value:
            raise InputError(
                f"{key}: a page has the whole loop, in double, and no such choice. Leave it out"
            )


def _symbol_prefix(name: str | None, title: str) -> str:
    """Return the prefix of all symbols. Raises InputError for a name that C cannot use."""
    prefix = to_identifier(to_identifier(title)[:24]) if name is None else name
    if not NAME.fullmatch(prefix) or to_identifier(prefix) != prefix:
        raise InputError(
            f"name: expected a letter, then up to 39 of a-z, 0-9 and single _, found {prefix!r}. "
            "Words of C and Python, headers and modules (math) are taken"
        )
    return prefix


def _initial_report(
    printed: Code, text: Source, labels: Labels, tunable: tuple[str, ...]
) -> dict[str, Any]:
    """Return the report on an export before any code runs."""
    step = printed.step
    return {
        "name": labels.prefix,
        "title": labels.title,
        "version": undeadzone.__version__,
        "hash": printed.hash,
        "part": labels.part,
        "precision": "single" if printed.single else "double",
        "step": step.Ts,
        "tunable": list(tunable),
        "two_phase": printed.phases is not None,
        "sizes": _struct_bytes(printed),
        "operations": printed.operations,
        "code_operations": text.operations,
        "functions": text.functions,
    }


def _boards_of(draft: _Draft) -> list[BoardFit]:
    """Return the cost of code on usual boards."""
    return fit_boards(draft.report, tuple(draft.text.texts_by_name().items()))


def _fit_leaner(
    scenario: Scenario, labels: Labels, precisions: Sequence[str], own: list[BoardFit]
) -> dict[str, list[str]]:
    """Return the boards that cheaper observers fit, by `change_method`'s name of each.

    Each is compiled and compared as in an export of its own. One that fits no board more than the
    code itself (`own`) is left out.
    """
    found = {}
    for method in _leaner_methods(scenario.observer):
        with suppress(InputError):  # the scenario cannot have it
            draft = _draft_code(change_method(scenario, method)[0], labels, precisions)
            fits = [after.board for after in _boards_of(draft) if after.fits]
            if not draft.report["refusals"] and not {*fits} <= {
                one.board for one in own if one.fits
            }:
                found[method] = fits
    return found


def _struct_bytes(printed: Code) -> dict[str, int]:
    """Return the sizes of the C structs [bytes]."""
    structs: dict[str, list[Field]] = {"params": []} | printed.structs
    each = 4 if printed.single else 8
    return {name: each * total_size(structs[name]) for name in ("state", "in", "out", "params")}


def constants_beyond_float(printed: Code) -> list[str]:
    """Return the numbers in double of a step that float cannot represent, with substitutes."""
    limits = np.finfo(np.float32)
    texts = set()
    bodies = [part.results for part in printed.parts]
    order = required_nodes(itertools.chain(*printed.results, *bodies))
    printed_constants = {node.constant_value for node in order if node.is_real}
    function = printed.step.function
    for value in itertools.chain(*map(read_constants, [function, *function.find_functions()])):
        is_float = float(limits.tiny) <= abs(value) <= float(limits.max)
        if value and not is_float and round_to_type(value, "float32") in printed_constants:
            texts.add(f"{value!r}: {c_literal(value, 'float32')}")
    return sorted(texts)


def _accuracy_report(printed: Code, text: Source, rows: Floats) -> dict[str, Any]:
    """Return the accuracy and its refusals."""
    if compiler.find_compiler() is None:
        refusals = [
            "float was not measured: no C compiler (cc, gcc or clang in PATH, or $CC)"
        ] * printed.single
        return {"accuracy": None, "stack": None, "refusals": refusals}
    found = accuracy.measure_accuracy(printed, text, rows)._asdict()
    return {"accuracy": found, "stack": found.pop("stack"), "refusals": found.pop("refusals")}
