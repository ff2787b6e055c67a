"""Location of the zone: at the sensor, in the plant as friction, at its input, or at two places."""

from __future__ import annotations

from collections.abc import Collection

from undeadzone.util.arrays import Floats
from undeadzone_identify.models.chain import VANISHING, ChainFit
from undeadzone_identify.models.elements import best_of_each
from undeadzone_identify.models.place import (
    WIDTHS,
    PlaceFit,
    PlaceShape,
    PlaceStarts,
    fit_place,
    join_place_numbers,
    raise_order,
)
from undeadzone_identify.models.zone_fit import ZoneFit

WORDS = {  # by the parts of a model that do not vanish
    (): "none",
    ("sensor",): "dead_zone",
    ("input",): "input_zone",
    ("inner",): "friction",
    ("sensor", "input"): "two_zones",
    ("sensor", "inner"): "zone_and_friction",
}
STEPS = 1.5  # quanta of rounded readings, below which a zone may be their own


def find_zone_locations(
    fit: ZoneFit, quantum: float, orders: Collection[int] = ()
) -> dict[str, PlaceFit]:
    """Find the best model of each location of the zone, by the verdict's class.

    The order of the plant is that behind the input itself. If a zone of the input leads, higher
    orders are tried behind it.

    Args:
        fit: plant and sensor zone, one record.
        quantum: of the readings, scaled.
        orders: of plants for which the log has enough samples.
    """
    fits = filter(lambda one: not _is_rounding_zone(one, quantum), _fit_all_locations(fit).values())
    found = best_of_each(fits, _word_of)
    top: PlaceFit | None = min(found.values(), key=lambda one: one.density.bic)
    while top is not None and top.model.shape.input and top.model.n + 1 in orders:
        word = _word_of(top)
        bic = top.density.bic
        top = raise_order(top)
        if top is None or top.density.bic > bic or _word_of(top) != word:
            break
        found[word] = top
    return found


def _word_of(one: PlaceFit) -> str:
    """Return the verdict's word; an element that vanishes counts for none."""
    model = one.model
    theta = one.theta
    shape = model.shape
    sensor = shape.sensor and model.part_numbers(theta, "sensor").sum() > VANISHING
    driven = shape.input and model.part_numbers(theta, "input").sum() > VANISHING
    rubs = shape.inner and model.friction_levels(theta).sum() > VANISHING
    words = {"sensor": sensor, "input": driven, "inner": rubs}
    return WORDS[tuple(name for name, is_there in words.items() if is_there)]


def _is_rounding_zone(one: PlaceFit, quantum: float) -> bool:
    """Return whether rounding explains the sensor zone of a model with a second zone."""
    shape = one.model.shape
    sensor = one.model.part_numbers(one.theta, "sensor")
    return bool(shape.sensor and (shape.input or shape.inner) and sensor.sum() < STEPS * quantum)


def is_rounding_play(one: ChainFit, quantum: float) -> bool:
    """Return whether rounding of the readings explains a play of the input.

    In a loop the input has steps of a rounded reading. A play takes them off.

    Args:
        one: fit of a chain.
        quantum: of the readings, scaled.
    """
    gap = float(one.theta[one.model.inputs].sum())
    moved = gap * abs(float(one.model.simulator.dc_gain(one.theta)[0]))
    return one.model.element == "play" and moved < STEPS * quantum


def _fit_all_locations(fit: ZoneFit) -> dict[str, PlaceFit]:
    """Fit every model of the zone's location; a model is no worse than the models that it
    contains.
    """
    starts = PlaceStarts(fit)
    fits: dict[str, PlaceFit] = {}

    def enter(shape: PlaceShape, begun: list[Floats]) -> None:
        """Fit a model and enter the result."""
        fitted = fit_place(starts.simulator, shape, [*begun, *_start_from_contained(shape, fits)])
        if fitted is not None:
            fits[shape.name] = fitted

    plants = (starts.linear_plant, starts.plant)
    enter(PlaceShape("none"), [join_place_numbers(plant, starts.n) for plant in plants])
    zone = join_place_numbers(starts.plant, starts.n, sensor=starts.widths)
    enter(PlaceShape("sensor", sensor=True), [zone])
    if starts.simulator.layout.m == 1:
        begun = starts.input_levels()
        zones = [join_place_numbers(plant, starts.n, input=level) for plant, level in begun]
        enter(PlaceShape("input", input=True), zones)
    enter(PlaceShape("friction", inner=True), starts.friction_at_input())
    shape = PlaceShape("friction of a position", inner=True, position=True)
    enter(shape, starts.friction_at_input())
    if starts.n > 1:
        shape = PlaceShape("friction, free", inner=True, free=starts.n - 1)
        enter(shape, starts.friction_elsewhere(fits))
    for name in ("friction", "friction, free"):
        if name in fits:
            free = fits[name].model.shape.free
            shape = PlaceShape(f"sensor and {name}", sensor=True, inner=True, free=free)
            enter(shape, starts.add_sensor_zone(fits[name]))
    if "input" in fits:
        shape = PlaceShape("sensor and input", sensor=True, input=True)
        enter(shape, starts.add_sensor_zone(fits["input"]))
    return fits


def _start_from_contained(shape: PlaceShape, fits: dict[str, PlaceFit]) -> list[Floats]:
    """Return the best fit among contained models as a start."""
    held = [one for one in fits.values() if shape.contains_shape(one.model.shape)]
    if not held:
        return []
    best = max(held, key=lambda one: float(one.density.value.sum()))
    theta = best.theta.copy()
    c = theta[best.model.base + WIDTHS :]
    c[: shape.free] = best.model.friction_coefficients(theta)[: shape.free]
    return [theta]
