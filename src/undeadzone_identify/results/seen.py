"""Account of a log by direct looks, and who speaks: a look, a name by the fits, or their number."""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import attrgetter

import numpy as np

from undeadzone_identify.logs.log import Log
from undeadzone_identify.looks.first import Looks
from undeadzone_identify.looks.map import APART, LEAST, UNSURE, FlatPart, RestMap
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.results.account import (
    BOUNDED,
    EFFECTS,
    INDICATED,
    MEASURED,
    NAMED,
    OPEN,
    Account,
    Numbers,
)

ENOUGH = 6  # rows beside an edge, from which it is measured
FLAT = (  # effects of a name that a flat part of the map shows as well
    "input loss",
    "input threshold",
    "output loss",
    "output threshold",
    "output range",
    "friction",
)
EDGES = {"left": "lower", "right": "upper"}
LOSS = "output loss"
UNMET = Interval(math.inf, math.inf, math.inf)  # an edge that no fit has
INPUT_LOSS = {"loss", "input threshold"}  # effects of a map that shows a band of the input


def account_of_looks(log: Log, looks: Looks) -> Account | None:
    """Return the account by the first look that sees something; None if none does.

    Args:
        log: that was looked at.
        looks: what is seen.
    """
    units = (log.input_unit, log.output_units[0])
    for one, effect, name, field, by in (
        (looks.friction, "friction", "level", "level", "torque along the motion"),
        (looks.rests, "free play", "gap", "play", "rests at one goal"),
    ):
        if one is not None and getattr(one, field).low > 0:
            grade = MEASURED if one.is_measured else INDICATED
            return Account(grade, {effect: {name: getattr(one, field)}}, by, units)
    if looks.at_rest is not None:
        return _account_of_map(looks.at_rest, "map at rest", units)
    if looks.of_rate is not None and looks.of_rate.flats:  # its bound is one of the steady rate
        return _account_of_map(looks.of_rate, "map of the rate at rest", units)
    if looks.ends:
        return Account(INDICATED, {"output range": looks.ends}, "stays at turning points", units)
    return None


def _account_of_map(seen: RestMap, by: str, units: tuple[str, str]) -> Account:
    """Return the account of a map at rest: its parts, else a bound."""
    by = f"{by} ({seen.x.size} levels of the command)"
    parts = list(map(_effect_of_part, seen.flats))
    effects = dict(parts + parts[::-1])  # the first of each
    if effects:
        rows = min(map(attrgetter("fewest_rows"), seen.flats))
        level = f"the reading rests at {seen.flats[0].level:.4g}"
        found = Account(INDICATED, effects, f"{by}, {level}", units)
        widest = max(map(attrgetter("widest_interval"), seen.flats))
        width = effects.get("loss", {}).get("width", UNMET)
        is_known = rows >= ENOUGH and widest < UNSURE * np.ptp(seen.x) and width.low > 0
        is_alone = seen.rows.how != "cloud"  # else what scatters it may follow the command
        return found._replace(grade=MEASURED) if is_known and is_alone else found
    if seen.fold is not None:
        edge = Interval(seen.fold, seen.fold, seen.fold)
        return Account(INDICATED, {"fold": {"edge": edge}}, by, units)
    curve = seen.curve
    limits = {"loss": seen.bound}
    if curve is None:
        return Account(BOUNDED, {}, by, units, limits=limits)
    for effect, name, one, along in (
        ("ways", "gap", curve.distance, seen.x),
        ("curve", "departure from a line", curve.departure, seen.y),
    ):
        if one is not None and one.low > LEAST * np.ptp(along):
            effects[effect] = {name: one}
        elif effect == "ways" and one is not None and one.high > 0:
            limits[effect] = one.high
    if not effects:
        return Account(BOUNDED, {}, by, units, limits=limits)
    if seen.bound > UNSURE * np.ptp(seen.x):
        del limits["loss"]  # beside an effect, a bound of most commands tells nothing
    is_known = seen.rows.how == "table" and curve.free >= ENOUGH
    others: dict[str, Numbers] = {}
    if seen.limits:
        others["limits"] = seen.limits
    grade = MEASURED if is_known else INDICATED
    return Account(grade, effects, by, units, others=others, limits=limits)


def _effect_of_part(part: FlatPart) -> tuple[str, Numbers]:
    """Return the effect of a flat part of a map with its edges."""
    edges = {EDGES[name]: getattr(part, name) for name in EDGES}
    numbers = {name: edge.interval for name, edge in edges.items() if edge is not None}
    if part.kind != "band":
        return part.kind, numbers
    if all(edge.jumps for edge in edges.values() if edge is not None):
        return "input threshold", numbers
    if len(numbers) == len(EDGES):
        low, high = numbers["lower"], numbers["upper"]
        ends = max(high.low - low.high, 0.0), high.high - low.low
        numbers["width"] = Interval(high.value - low.value, *ends)
    return "loss", numbers


def needs_no_plant(seen: Account, looks: Looks) -> bool:
    """Return whether dynamics tell no more than an account by looks.

    A table, a slow sweep, and rows without a clock that a curve explains have no dynamics. A torque
    along a motion, or two rests at one goal, need none.

    Args:
        seen: the account by looks.
        looks: what is seen.
    """
    one = looks.at_rest
    if looks.friction is not None or looks.rests is not None:
        return seen.grade == MEASURED
    if one is None or one.rows.how == "holds":
        return False
    has_shape = bool(one.flats) or one.fold is not None  # and no lag has one
    return has_shape or one.curve is not None or one.rows.how == "table"


def rests_in_holds(looks: Looks) -> bool:
    """Return whether a flat part is seen while the command stays at each of its levels."""
    one = looks.at_rest
    return one is not None and bool(one.flats) and one.rows.how == "holds"


def choose_account(
    fitted: Account, seen: Account | None, looks: Looks, knows_the_end: Callable[[], bool]
) -> Account:
    """Return the account that speaks: a name by the fits, else a measured number, else theirs.

    Args:
        fitted: by the fits of a plant.
        seen: by looks; None: they see nothing.
        looks: what is seen. No bound is below the travel of the command while the reading stood
            still.
        knows_the_end: whether a zone that is named is told from one of the input.
    """
    if seen is not None:
        named = fitted.effects.keys() if fitted.grade == NAMED else set()
        edges = {
            EDGES[key]: one for key, one in fitted.effects.get(LOSS, {}).items() if key in EDGES
        }
        is_flat = named & {*FLAT} and knows_the_end() and not _contradicts(fitted, seen)
        is_flat = is_flat and all(one.low > 0 for one in edges.values())
        is_flat = is_flat and edges.keys() <= seen.first_numbers.keys()  # it shows no others
        has_number = fitted.grade == NAMED or bool(fitted.first_numbers)
        is_better = seen.grade == MEASURED or not has_number
        if seen.effects and is_better and not is_flat:
            others = {key: one for key, one in fitted.effects.items() if key not in seen.effects}
            return seen._replace(others=others | fitted.others)
    rest = looks.at_rest
    if rest is not None and fitted.grade == INDICATED and _moves_in_band(fitted, rest):
        fitted = fitted._replace(grade=OPEN, effects={}, others={})
    if seen is not None and fitted.grade == OPEN and seen.grade == BOUNDED:
        return seen
    limits = {
        key: max(bound, looks.stillness * (EFFECTS[key].end == "input"))
        for key, bound in fitted.limits.items()
    }
    return fitted._replace(limits=limits)


def _contradicts(fitted: Account, seen: Account) -> bool:
    """Return whether a band of the input is wider or narrower by its fit than in a map."""
    band = INPUT_LOSS & seen.effects.keys()
    own = fitted.effects.get("input loss", {}).get("width")
    if own is None or not band:
        return False
    edges = seen.effects[band.pop()]
    if len(edges) < len(EDGES):
        return False
    low, high = edges["lower"], edges["upper"]
    return own.high < high.low - low.high or own.low > high.high - low.low


def _moves_in_band(fitted: Account, at_rest: RestMap) -> bool:
    """Return whether the map at rest moves where a band of the input, by its fit, moves nothing."""
    band = fitted.effects.get("input loss", {})
    low, high = (band.get(side, UNMET).value for side in EDGES)
    inside = (at_rest.x > -low) & (at_rest.x < high)
    is_met = len(band) > 0 and inside.any()
    return bool(is_met and np.ptp(at_rest.y[inside]) > APART * np.ptp(at_rest.y))
