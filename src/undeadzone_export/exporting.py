"""From a scenario to a folder of C, with the report of what it costs and how exact it is."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

import undeadzone
from undeadzone.compile.graph import required_nodes
from undeadzone.compile.print_c import c_literal
from undeadzone.errors import InputError
from undeadzone.registry import OBSERVERS
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats, finite
from undeadzone.util.text import HALF_95
from undeadzone_export import accuracy, compiler, exported_step, targets
from undeadzone_export.boards import fits
from undeadzone_export.code import Code, code, operations
from undeadzone_export.exported_step import Field, identifier, total
from undeadzone_export.fmu.package import require_buildable
from undeadzone_export.page.build import write_page
from undeadzone_export.selftest_vectors import (
    choose_vectors,
    continue_scenario,
    record_inputs,
    reference,
)
from undeadzone_export.source import Labels, Source, source
from undeadzone_export.targets import Material

PRECISIONS = ("single", "double")
FIRMWARE = ("c", "arduino")  # targets whose boards matter
ELSEWHERE = ("arduino", "st")  # targets whose self-test runs on the target alone
MANY = 20_000  # operations of a step, whose code a compiler takes a minute for
STEPS = 100_000  # of the comparison of float with double, at least
NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")


class Exported(NamedTuple):
    """What an export wrote, and what it found.

    Attributes:
        files: the files written.
        report: name, hash, sizes and the stack on this computer [bytes], operations of a step,
            accuracy, and `refusals`: why the code should not be used, with the number; empty where
            all is well.
        code: what was printed; None of a page.
    """

    files: list[Path]
    report: dict[str, Any]
    code: Code | None = None

    @property
    def has_passed(self) -> bool:
        """Return whether nothing was refused."""
        return not self.report["refusals"]


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
    told: Callable[[str], object] | None = None,
) -> Exported:
    """Write a scenario's observer as C99 that runs without a library.

    Args:
        scenario: a scenario with simulation.time = "sampled".
        to: "c"; "arduino" for a library of the Arduino IDE; "st" for Structured Text of
            IEC 61131-3; "fmu2" or "fmu3" for an FMU for co-simulation; "python" for a module that
            needs no undeadzone; "page" for one HTML file in which the scenario's loop runs.
        out: folder for the files, or the HTML file; replaced if it is an earlier export. Other
            files in the folder stay.
        precision: "single" for float, or "double"; default: double but for "c", "arduino" and "st".
        part: "observer", or "observer+controller".
        tunable: numbers that stay parameters of the code, such as "observer.gamma".
        name: what every symbol begins with; default: made of the scenario's title.
        check: also build the self-test with this computer's compiler and run it (not for Arduino
            and Structured Text).
        force: replace files that someone else wrote or edited, where they are in the way; other
            files stay all the same.
        told: called with a sentence before something that takes minutes begins.

    Returns:
        The files, and a report. Accuracy is measured where there is a C compiler; single
        precision that was not measured counts as refused.

    Raises:
        InputError: a scenario that cannot be exported, or an unknown option.
        FileError: the folder is something else, or cannot be written.
    """
    _require("to", to, tuple(targets.PRECISION))
    precision = targets.PRECISION[to] if precision is None else precision
    _require("precision", precision, PRECISIONS)
    tunable = tuple(dict.fromkeys(tunable))
    if to == "page":
        _require_plain(precision, part, tunable, name, check)
        return Exported([Path(out)], write_page(scenario, Path(out), force))
    prefix = _prefix(name, scenario.title)
    targets.require_replaceable(Path(out), force)
    if to in targets.VERSIONS:
        require_buildable(prefix, targets.VERSIONS[to])
    problem = resolve_scenario(scenario)
    step = exported_step.build(problem, part, tunable)
    double = code(step, single=False)
    printed = code(step, single=True) if precision == "single" else double
    labels = Labels(prefix, scenario.title, part)
    count = sum(operations(printed.results).values())
    if told is not None and count > MANY:
        told(_minutes(count, scenario.observer))
    text = source(printed, labels)
    rows = record_inputs(continue_scenario(scenario, STEPS), step)
    report = _report(printed, text, labels, tunable)
    report["replaced_constants"] = replacements_for_float(double) if printed.single else []
    report |= _measure_accuracy(double, printed, text, rows)
    if to in FIRMWARE:
        found = fits(report)
        report["boards"] = [fit._asdict() for fit in found]
        if not all(fit.fits for fit in found):
            report["leaner"], leaner = _leaner(scenario, part, printed.single)
            everyone = {scenario.observer.__struct_config__.tag: scenario} | leaner
            report["runs"] = {tag: _along(other) for tag, other in everyone.items()}
    vectors = reference(printed, choose_vectors(rows[: problem.steps + 1], step.readings))
    material = Material(printed, labels, text, vectors, scenario.units, report)
    files = targets.files(to, material)
    written = targets.write_folder(files, Path(out), force)
    if check and to not in ELSEWHERE:
        passed, said = compiler.self_tested(material.c_files)
        report["self_test"] = said
        if not passed:
            report["refusals"] = [*report["refusals"], f"the self-test fails: {said}"]
    return Exported(written, report, printed)


def _minutes(count: int, observer: Any) -> str:
    """What many operations take, and what would take less."""
    said = f"{count:,} operations a sample: about {count // 100:,} kB of code, for which a compiler"
    less = " or ".join(map(setting, _choices(observer)))
    return f"{said} takes minutes" + f"; {less} takes less" * bool(less)


def setting(name: str) -> str:
    """What sets an observer of `report["leaner"]`: an option, or else the method."""
    return f"observer.{name}" if "=" in name else f'observer.method = "{name}"'


def _choices(observer: Any) -> dict[str, Callable[[], Any]]:
    """What makes an observer of fewer operations, by name; not every scenario can have each."""
    if hasattr(observer, "starts"):
        fewer = partial(msgspec.structs.replace, observer, starts=1)
        return {} if observer.starts == 1 else {"starts = 1": fewer}
    own = observer.__struct_config__.tag
    leaner: dict[str, Callable[[], Any]] = {}
    if own not in ("kalman", "certified"):
        sides = ("right", "left")
        claims = {name: getattr(observer, name) for name in sides if hasattr(observer, name)}
        leaner["kalman"] = partial(OBSERVERS.create, "kalman", **claims)
    if own != "certified":
        leaner["certified"] = partial(OBSERVERS.create, "certified")
    return leaner


def _require(key: str, value: str, known: tuple[str, ...]) -> None:
    """Raise InputError for a word that is not known."""
    if value not in known:
        raise InputError(f"{key}: expected one of {', '.join(known)}, found {value!r}")


def _require_plain(
    precision: str, part: str, tunable: tuple[str, ...], name: str | None, check: bool
) -> None:
    """Raise InputError for an option that means nothing to a page."""
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
                f"{key}: a page has the whole loop, in double, and no such choice; leave it out"
            )


def _prefix(name: str | None, title: str) -> str:
    """What every symbol begins with. Raises InputError for a name that C cannot use."""
    prefix = identifier(identifier(title)[:24]) if name is None else name
    if not NAME.fullmatch(prefix) or identifier(prefix) != prefix:
        raise InputError(
            f"name: expected a letter, then up to 39 of a-z, 0-9 and single _, found {prefix!r}; "
            "words of C and Python, headers and modules (math) are taken"
        )
    return prefix


def _report(
    printed: Code, text: Source, labels: Labels, tunable: tuple[str, ...]
) -> dict[str, Any]:
    """What is known of an export before anything runs."""
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
        "sizes": _sizes(printed),
        "operations": operations(printed.results),
        "functions": text.functions,
    }


def _leaner(
    scenario: Scenario, part: str, is_single: bool
) -> tuple[dict[str, list[str]], dict[str, Scenario]]:
    """Return (boards that observers of fewer operations fit, the scenario with each), by their
    tags.
    """
    found, scenarios = {}, {}
    for name, made in _choices(scenario.observer).items():
        with suppress(InputError, TypeError):  # the scenario cannot have it
            other = msgspec.structs.replace(scenario, observer=made())
            printed = code(exported_step.build(resolve_scenario(other), part, ()), single=is_single)
            costs = {
                "precision": "single" if is_single else "double",
                "step": scenario.simulation.step,
                "sizes": _sizes(printed),
                "operations": operations(printed.results),
            }
            found[name] = [fit.board for fit in fits(costs) if fit.fits]
            scenarios[name] = other
    return found, scenarios


def _along(scenario: Scenario) -> dict[str, float | None]:
    """What an observer does along the run: rms of z - z^, and how often widths were covered."""
    run = simulate(scenario, check_step=False)
    covered = None
    if run.d_std is not None:
        inside = np.abs(np.ravel(run.info.widths) - run.d_hat) <= HALF_95 * run.d_std
        covered = float(inside[run.last].mean())
    return {"rms": finite(run.rms_estimation), "coverage": covered}


def _sizes(printed: Code) -> dict[str, int]:
    """Return the bytes of the structs of C."""
    structs: dict[str, list[Field]] = {"params": []} | printed.structs
    each = 4 if printed.single else 8
    return {name: each * total(structs[name]) for name in ("state", "in", "out", "params")}


def replacements_for_float(double: Code) -> list[str]:
    """Return the numbers of the code in double that float cannot hold, and what stands for them."""
    limits, texts = np.finfo(np.float32), set()
    for node in required_nodes(itertools.chain(*double.results)):
        size = abs(node.value or 0.0)
        if size > float(limits.max) or 0 < size < float(limits.tiny):
            texts.add(f"{node.text}: {c_literal(float(node.text), 'float32')}")
    return sorted(texts)


def _measure_accuracy(double: Code, printed: Code, text: Source, rows: Floats) -> dict[str, Any]:
    """Return the accuracy, and what it refuses."""
    if compiler.compiler() is None:
        message = "accuracy was not measured: no C compiler (cc, gcc or clang in PATH, or $CC)"
        refusals = [message] if printed.single else []
        return {"accuracy": None, "stack": None, "refusals": refusals}
    found = accuracy.measure(double, printed, text, rows)._asdict()
    return {"accuracy": found, "stack": found.pop("stack"), "refusals": found.pop("refusals")}
