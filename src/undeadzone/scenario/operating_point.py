"""The operating point: input and output at rest, from which the numbers of a scenario count.

Plant, sensor, actuator, observer and controller are in deviations from it. Signals outside are in
the units of the plant, so they are shifted once, where they enter and leave: along a log
(`simulation.follower`), in a result (`simulation.collect`) and in exported code
(`undeadzone_export.exported_step`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate
from undeadzone.plants.system import System
from undeadzone.util.arrays import Array, Floats, require_vector
from undeadzone.util.toml import OptionTable

LEVELS: Final = {  # signals that count from a level, by name
    **dict.fromkeys(("z", "z_hat", "z_inverse", "z_smooth", "level"), "z"),
    **{name: name for name in ("y", "u", "r")},
}


class OperatingPoint(OptionTable, frozen=True, kw_only=True):
    """Input and output at rest, from which every number of a scenario counts.

    Example:
        >>> uz.OperatingPoint(input=45.0, output=310.0).output
        310.0

    See Also:
        Scenario, estimate

    Attributes:
        input: u at rest: one number, or one per input (m) [u].
        output: z at rest under it: one number, or one per output (p) [z].
    """

    input: Array = 0.0
    output: Array = 0.0


class Levels(NamedTuple):
    """Levels of the signals at the operating point.

    Attributes:
        u: of the inputs (m) [u].
        z: of the outputs (p) [z].
        y: of the readings (p) [y].
        r: of the reference (tracked) [z].
    """

    u: Floats
    z: Floats
    y: Floats
    r: Floats

    def restore_estimate(self, estimate: Estimate) -> Estimate:
        """Return an estimate in the units of the plant: an expression, or a row per sample."""
        return estimate._replace(z=estimate.z + self.z, z_inverse=estimate.z_inverse + self.z)


def resolve_levels(
    point: OperatingPoint | None, plant: System, slope: Floats, tracked: Sequence[int]
) -> Levels | None:
    """Return the checked levels at an operating point, or None if all are 0.

    Args:
        point: in a user's words (None: there is none).
        plant: the plant.
        slope: of the sensor (p) [y/z].
        tracked: numbers of the outputs that follow the reference.

    Raises:
        InputError: or a subclass, that names the key.
    """
    if point is None:
        return None
    if plant.nonlinear:
        raise InputError(
            "operating_point: needs a linear plant, found one that is given by formulas or an arm,"
            " whose equations hold about 0 alone. Leave the table out, and put the levels into the"
            " formulas"
        )
    u = require_vector("operating_point.input", point.input, plant.m, "one per input")
    z = require_vector("operating_point.output", point.output, plant.p, "one per output")
    if not u.any() and not z.any():
        return None
    return Levels(u, z, slope * z, z[list(tracked)])


def restore_signals(levels: Levels | None, signals: Mapping[str, Any]) -> dict[str, Any]:
    """Return signals of a result in the units of the plant.

    Args:
        levels: at the operating point (None: there are none).
        signals: deviations by name, a row for each sample (None: there is no such signal).
    """
    restored = dict(signals)
    for name in LEVELS.keys() & signals.keys():
        if levels is not None and signals[name] is not None:
            restored[name] = signals[name] + getattr(levels, LEVELS[name])
    return restored
