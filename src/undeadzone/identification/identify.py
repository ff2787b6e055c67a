"""`identify`: from a log to plant, widths and verdict."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from undeadzone.errors import InputError
from undeadzone.identification.climb import KeptClimbs
from undeadzone.identification.grid import to_grid
from undeadzone.identification.log import Log
from undeadzone.identification.one_output import identify_output
from undeadzone.identification.options import Options
from undeadzone.identification.outputs import IdentifiedOutputs
from undeadzone.identification.readers import log_of_arrays, read_log
from undeadzone.identification.result import Identified
from undeadzone.support.answers import Answers
from undeadzone.support.progress import in_notebook


def identify(
    log: Any = None,
    *,
    t: Any = None,
    u: Any = None,
    y: Any = None,
    order: str | int = "1-4",
    right: str | float | None = None,
    left: str | float | None = None,
    offset: str | float = 0.0,
    held_out: float = 0.3,
    noise: str = "auto",
    place: str = "auto",
    kind: str = "auto",
    delay: str | int = "auto",
    zero: float = 0.0,
    threshold: float | None = None,
    resample: float | None = None,
    integrators: int = 0,
    columns: str | None = None,
    strict: bool = False,
    progress: Callable[[int], None] | None = None,
    keep: Path | None = None,
    resume: bool = False,
) -> Identified | IdentifiedOutputs:
    """Find plant and dead zone from a log, with intervals that hold (docs/identify.md).

    Args:
        log: path of a CSV, .npz or .mat file, a pandas DataFrame, or a list of these: several
            records of one plant.
        t: times (N) [s], or the step; with u and y, in place of `log`.
        u: inputs (N) or (N x m).
        y: readings (N) or (N x p); NaN where one is missing.
        order: orders of the plant to try, as 2 or "1-4".
        right: d_r if known, "0.2,1.0" for bounds, inf for no such edge [y].
        left: the same for d_l.
        offset: rms of a constant offset of the output [y], or "free".
        held_out: share of the log, at its end, that checks the fit.
        noise: "before" the zone, "after" it, or "auto".
        place: "sensor" where the user knows that the zone is there, or "auto".
        kind: "deadzone", "jump" (readings are not shifted), "play" or "auto".
        delay: samples by which the recording makes the input late, or "auto" to find how late it
            acts.
        zero: what the sensor reads inside its zone [y].
        threshold: |y| up to which a reading is silent [y]; default half the quantum.
        resample: step [s] for logs of irregular step.
        integrators: how many poles of the plant are integrators: 1 where a motor's position is
            read.
        columns: which column is which where names do not say it: `t=1,y=angle,u=voltage`.
        strict: whether a line that cannot be read is an error; else its sample is missing.
        progress: called with the number of steps just done; None: a bar in a notebook.
        keep: file that keeps what was fitted, to be deleted once the answer is; None: none.
        resume: take up what a stopped call left in `keep`.

    Returns:
        Verdict, widths with intervals, plant, states, scenario; of several outputs one such
        answer each.

    Raises:
        FileError: a log that cannot be read, or `keep`.
        InputError: a log from which nothing can be learnt, or an option that cannot be used.
    """
    words = {
        "noise": ("before", "after", "auto"),
        "place": ("sensor", "auto"),
        "kind": ("deadzone", "jump", "play", "auto"),
    }
    for name, value in (("noise", noise), ("place", place), ("kind", kind)):
        if value not in words[name]:
            raise InputError(f"{name}: expected {', '.join(words[name])}; found {value!r}")
    options = Options(
        order=str(order),
        right=None if right is None else str(right),
        left=None if left is None else str(left),
        offset=str(offset),
        held_out=float(held_out),
        noise=noise,  # type: ignore[arg-type]
        place=place,  # type: ignore[arg-type]
        kind=kind,  # type: ignore[arg-type]
        delay=str(delay),
        zero=float(zero),
        threshold=threshold,
        resample=resample,
        integrators=int(integrators),
    ).checked()
    logs = [one._replace(y=one.y - options.zero) for one in _logs(log, t, u, y, columns, strict)]
    with in_notebook(progress, "identifying", None) as advance:
        if keep is None:
            return _identified(logs, options, advance)
        return _kept(logs, options, advance, keep, resume)


def _kept(
    logs: list[Log],
    options: Options,
    advance: Callable[[int], None],
    keep: Path,
    resume: bool,
) -> Identified | IdentifiedOutputs:
    """The answer; what was fitted is kept in a file. Raises InputError."""
    answers = Answers(keep, _problem(logs, options), "fits", resume)
    climbs = KeptClimbs(answers)
    with answers.kept():
        try:
            return _identified(logs, options, advance, climbs)
        except InputError as error:  # nothing was stopped
            refused = error
        finally:
            climbs.close()
    keep.unlink(missing_ok=True)
    raise refused


def _problem(logs: list[Log], options: Options) -> dict[str, Any]:
    """Everything that a fit depends on."""
    digests = []
    for log in logs:
        sums = [hashlib.blake2b(part.tobytes(), digest_size=16) for part in (log.t, log.u, log.y)]
        digests.append([one.hexdigest() for one in sums])
    return {"logs": digests, "options": msgspec.to_builtins(options)}


def _identified(
    logs: list[Log],
    options: Options,
    advance: Callable[[int], None],
    climbs: KeptClimbs | None = None,
) -> Identified | IdentifiedOutputs:
    """The answer of one output, or of each of several. Raises InputError."""
    names = logs[0].outputs
    for log in logs:
        if len(log.outputs) != len(names):
            raise InputError(f"{log.source}: has {len(log.outputs)} outputs, others {len(names)}")
    answers = []
    for k in range(len(names)):
        alone = [log.of_output(k) for log in logs]
        answers.append(identify_output(to_grid(alone, options.resample), options, advance, climbs))
    return answers[0] if len(answers) == 1 else IdentifiedOutputs(names, tuple(answers))


def _logs(log: Any, t: Any, u: Any, y: Any, columns: str | None, strict: bool) -> list[Log]:
    """The logs that a user gave as files, frames or arrays. Raises InputError."""
    arrays = [value is not None for value in (t, u, y)]
    if log is None:
        if not all(arrays):
            raise InputError("identify: give a log, or t, u and y")
        return [log_of_arrays(t, u, y)]
    if any(arrays):
        raise InputError("identify: give a log, or t, u and y, not both")
    sources = log if isinstance(log, list | tuple) else [log]
    if not sources:
        raise InputError("identify: the list of logs is empty")
    return [read_log(source, columns, strict) for source in sources]
