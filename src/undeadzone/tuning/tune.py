"""Tuning: the numbers of observer and controller that make a metric small over many runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from undeadzone.analysis.certificate.passivity import certify
from undeadzone.ensemble.addresses import stem
from undeadzone.errors import InputError, StructureError, UndeadzoneError
from undeadzone.scenario.problem import Problem, constant_gains, resolve_scenario
from undeadzone.scenario.reader import digests
from undeadzone.scenario.schema import Scenario
from undeadzone.scenario.tune_table import TABLE, Tune
from undeadzone.support import toml
from undeadzone.support.answers import Answers
from undeadzone.support.arrays import Floats, scalar
from undeadzone.support.progress import in_notebook
from undeadzone.tuning.objective import Frame, certified_margin, objective
from undeadzone.tuning.parameters import Parameter, named, numbers, parameters, with_numbers
from undeadzone.tuning.result import Tuned, validate
from undeadzone.tuning.search import Search, values_at

GAINS = "observer.L"  # the one array that an observer has by default


def tune(
    scenarios: Scenario | Sequence[Scenario],
    what: Tune | None = None,
    *,
    frames: Sequence[Frame] | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
    keep: Path | None = None,
    resume: bool = False,
) -> Tuned:
    """Tune one scenario, or several at once with the same numbers in each.

    Candidates are lanes and meet the same runs. Half of the budget searches the box by CMA-ES,
    Hansen and Ostermeier (2001), or on a grid for a single number. Then, for the mean, which is
    smooth, L-BFGS-B (SLSQP under the certificate) follows gradients whose differences are lanes
    too. What is left goes to CMA-ES around the best, which needs no slope where runs take turns as
    the median or the worst. The same seed gives the same numbers, whatever the threads.

    Args:
        scenarios: one, or several whose mean is made small
        what: numbers and their bounds, metric, statistic, budget; default: the [tune] of the first
            scenario
        frames: what counts as 0 and as 1 in each scenario; default: the metric itself
        threads: on which to compute; default: one per processor
        progress: called with the number of candidates just tried; None: a bar in a notebook
        keep: file that keeps what candidates cost, to be deleted once the result is; None: none
        resume: take up what a stopped search left in `keep`

    Returns:
        The tuned scenarios, every candidate, and what the numbers are worth on held-out runs.

    Raises:
        InputError or a subclass: by key of [tune]; FileError for `keep`
    """
    scenarios = (scenarios,) if isinstance(scenarios, Scenario) else tuple(scenarios)
    what = _checked(scenarios, what)
    scenarios = tuple([_with_gains(scenario, what) for scenario in scenarios])
    frames = _checked_frames(scenarios, frames)
    seed = _seed(scenarios[0], what)
    tuned = _parameters(what, scenarios)
    start = np.array([p.share(p.start) for p in tuned])
    names = [p.name for p in tuned]
    probes = values_at(tuned, _probes(start))
    on = objective(what, scenarios, frames, names, probes, what.runs, seed)
    with in_notebook(progress, "tuning", what.budget, "candidates") as advance:
        search = Search(on, tuned, [], threads, advance)
        if keep is None:
            search.run(start, seed)
            return validate(on, tuned, search.candidates, search.best, seed, threads)
        kept = Answers(keep, _problem(scenarios, what, frames, seed), "candidates", resume)
        with kept.kept():
            search._replace(kept=kept).run(start, seed)
            return validate(on, tuned, search.candidates, search.best, seed, threads)


def _problem(
    scenarios: Sequence[Scenario], what: Tune, frames: Sequence[Frame], seed: int
) -> dict[str, Any]:
    """Everything that the cost of a candidate depends on; the budget is none of it."""
    return {
        "scenarios": [toml.dumps(scenario) for scenario in scenarios],
        "files": [digests(scenario) for scenario in scenarios],
        "tune": msgspec.to_builtins(msgspec.structs.replace(what, budget=0, held_out=0)),
        "frames": [list(frame) for frame in frames],
        "seed": seed,
    }


def _probes(start: Floats) -> Floats:
    """Candidates (rows of shares) that move whatever any candidate moves, the start first.

    They are each number alone, and all of them, at places that are no accident.
    """
    places = (0.0, 0.3, 0.7, 1.0)
    probes = [start]
    for i in range(start.size):
        for u in places:
            probe = start.copy()
            probe[i] = u
            probes.append(probe)
    for u in places:
        probes.append(np.full(start.size, u))
    return np.vstack(probes)


def _checked(scenarios: tuple[Scenario, ...], what: Tune | None) -> Tune:
    """What is wanted. Raises InputError."""
    if not scenarios:
        raise InputError("tune: expected at least one scenario, found none")
    what = what or scenarios[0].tune or Tune()
    for key, least in (("runs", 1), ("held_out", 1), ("budget", 4)):
        if getattr(what, key) < least:
            raise InputError(f"tune.{key}: expected {least} or more, found {getattr(what, key)}")
    scalar("tune.margin", what.margin, least=0.0)
    return what


def _checked_frames(
    scenarios: tuple[Scenario, ...], frames: Sequence[Frame] | None
) -> Sequence[Frame]:
    """A frame for each scenario. Raises InputError."""
    if frames is None:
        return [Frame()] * len(scenarios)
    sound = all(np.isfinite(frame).all() and frame.zero < frame.one for frame in frames)
    if len(frames) != len(scenarios) or not sound:
        raise InputError(
            f"frames: expected one for each of {len(scenarios)} scenarios, with zero below one, "
            f"found {list(frames)!r:.80}"
        )
    return frames


def _seed(scenario: Scenario, what: Tune) -> int:
    """The seed of the runs tuned on. Raises InputError.

    It is that of [tune], else of [ensemble], else of [simulation].
    """
    seed = scenario.simulation.seed
    if scenario.ensemble is not None and scenario.ensemble.seed is not None:
        seed = scenario.ensemble.seed
    if what.seed is not None:
        seed = what.seed
    if not 0 <= seed < 2**63 - 1:
        raise InputError(f"tune.seed: expected a whole number, 0 or more, found {seed}")
    return seed


def _with_gains(scenario: Scenario, what: Tune) -> Scenario:
    """The scenario with its observer's default L, where L is tuned but left to the method.

    What is tuned of it is moved into its bounds.
    """
    named_gains = [address for address in what.entries if stem(address) == GAINS]
    if not named_gains or getattr(scenario.observer, "L", 0.0) is not None:
        return scenario
    problem = resolve_scenario(scenario)
    gains = constant_gains(problem.observer, problem.model)
    if gains is None or getattr(scenario.observer, "design", None) is not None:
        return scenario
    L = gains[0].ravel() if problem.model.p == 1 else gains[0]
    observer: Any = scenario.observer
    scenario = msgspec.structs.replace(scenario, observer=msgspec.structs.replace(observer, L=L))
    known, moved = numbers(scenario), {}
    for address in named_gains:
        low, high = what.entries[address].between
        for name in named(address, known):
            value = known[name].value
            assert value is not None
            moved[name] = min(max(value, low), high)
    return with_numbers(scenario, moved)


def _parameters(what: Tune, scenarios: tuple[Scenario, ...]) -> tuple[Parameter, ...]:
    """What is tuned, in every scenario, from a start that can be run.

    Raises InputError or a subclass.
    """
    tuned = parameters(what.entries, scenarios[0])
    start = {p.name: p.start for p in tuned}
    for scenario in scenarios:
        resolve_scenario(scenario)
        missing = start.keys() - numbers(scenario).keys()
        if missing:
            place = TABLE.entry_name(min(missing))
            raise InputError(f"{place}: scenario {scenario.title!r} has no such number")
        try:
            problem = resolve_scenario(with_numbers(scenario, start))
        except UndeadzoneError as error:
            words = ", ".join(f"{name} = {value:g}" for name, value in start.items())
            raise InputError(f"tune: cannot start from {words}: {error}") from None
        if what.certified:
            _require_certificates(problem)
    return tuned


def _require_certificates(problem: Problem) -> None:
    """Raise InputError or StructureError where no gains of a problem's observer are certified."""
    certified_margin(problem)
    model = problem.model
    proof = certify(model.linear, np.zeros((model.n, model.p)), np.ones(model.p), model.Ts)
    if proof.reason:
        raise StructureError(f"tune.certified: no gains can be certified: {proof.reason}")
