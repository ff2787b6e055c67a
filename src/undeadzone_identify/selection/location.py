"""Where is the zone: at the sensor, in the plant as friction, at its input, or at two of them?"""

from __future__ import annotations

from undeadzone.util.arrays import Floats
from undeadzone_identify.models.chain import VANISHING
from undeadzone_identify.models.elements import best_of_each
from undeadzone_identify.models.place import WIDTHS, PlaceFit, PlaceStarts, Shape, fit_place
from undeadzone_identify.models.zone_fit import Fit

WORDS = {  # by the parts of a model that do not vanish
    (): "none",
    ("sensor",): "dead_zone",
    ("input",): "input_zone",
    ("inner",): "friction",
    ("sensor", "input"): "two_zones",
    ("sensor", "inner"): "zone_and_friction",
}
STEPS = 1.5  # quanta of rounded readings, below which a zone may be their own


def find_places(fit: Fit, quantum: float) -> dict[str, PlaceFit]:
    """Return the best model of each place of the zone, by the verdict's word for it.

    Args:
        fit: plant and sensor zone, one record.
        quantum: of the readings, scaled.
    """
    fits = filter(lambda one: not _is_of_steps(one, quantum), _fit_all(fit).values())
    return best_of_each((_word_of(one), one.density.bic, one) for one in fits)


def _word_of(one: PlaceFit) -> str:
    """Return the verdict's word for what is there: an element that vanishes is not."""
    model, theta = one.model, one.theta
    shape = model.shape
    sensor = shape.sensor and model.part(theta, "sensor").sum() > VANISHING
    driven = shape.input and model.part(theta, "input").sum() > VANISHING
    rubs = shape.inner and sum(_friction_levels(one)) > VANISHING
    words = {"sensor": sensor, "input": driven, "inner": rubs}
    return WORDS[tuple(name for name, is_there in words.items() if is_there)]


def _is_of_steps(one: PlaceFit, quantum: float) -> bool:
    """Return whether a model has a zone of the sensor, beside another one, that rounding
    explains.
    """
    shape, sensor = one.model.shape, one.model.part(one.theta, "sensor")
    return bool(shape.sensor and (shape.input or shape.inner) and sensor.sum() < STEPS * quantum)


def _fit_all(fit: Fit) -> dict[str, PlaceFit]:
    """Return every model of the zone's place, fitted; one that holds others is no worse than
    they.
    """
    starts = PlaceStarts(fit)
    fits: dict[str, PlaceFit] = {}

    def enter(shape: Shape, begun: list[Floats]) -> None:
        fitted = fit_place(starts.simulator, shape, [*begun, *_best_smaller_model(shape, fits)])
        if fitted is not None:
            fits[shape.name] = fitted

    enter(Shape("none", "none"), starts.none())
    enter(Shape("sensor", "dead_zone", sensor=True), starts.at_sensor())
    if starts.simulator.layout.m == 1:
        enter(Shape("input", "input_zone", input=True), starts.at_input())
    enter(Shape("friction", "friction", inner=True), starts.friction())
    shape = Shape("friction of a position", "friction", inner=True, position=True)
    enter(shape, starts.friction())
    if starts.n > 1:
        shape = Shape("friction, free", "friction", inner=True, free=starts.n - 1)
        enter(shape, starts.free(fits))
    for name in ("friction", "friction, free"):
        if name in fits:
            free = fits[name].model.shape.free
            shape = Shape(f"{name}, sticking", "friction", inner=True, sticks=True, free=free)
            enter(shape, starts.sticking(fits[name]))
            together = "zone_and_friction"
            shape = Shape(f"sensor and {name}", together, sensor=True, inner=True, free=free)
            enter(shape, starts.with_sensor(fits[name]))
    if "input" in fits:
        shape = Shape("sensor and input", "two_zones", sensor=True, input=True)
        enter(shape, starts.with_sensor(fits["input"]))
    return fits


def _best_smaller_model(shape: Shape, fits: dict[str, PlaceFit]) -> list[Floats]:
    """Return the end of the best of the models that a larger one holds."""
    held = [one for one in fits.values() if shape.holds(one.model.shape)]
    if not held:
        return []
    best = max(held, key=lambda one: float(one.density.value.sum()))
    theta = best.theta.copy()
    c = theta[best.model.base + WIDTHS :]
    c[: shape.free] = best.model.c(theta)[: shape.free]
    return [theta]


def levels_of(fits: dict[str, PlaceFit]) -> dict[str, tuple[float, float]]:
    """Return friction and the zone of the input, right and left, in units of the input, scaled.

    Args:
        fits: by word.
    """
    levels = {}
    for word, one in fits.items():
        model, theta = one.model, one.theta
        if word == "friction":
            levels[word] = _friction_levels(one)
        if model.shape.input:
            right, left = model.part(theta, "input")
            levels[word] = (float(right), float(left))
    return levels


def _friction_levels(one: PlaceFit) -> tuple[float, float]:
    """Return friction right and left, in units of the input, scaled."""
    model, theta = one.model, one.theta
    b = theta[model.n : 2 * model.n]
    force = abs(b.sum()) / max(abs(1 + model.c(theta).sum()), 1e-9)
    right, left = model.part(theta, "inner") / max(force, 1e-9)
    return float(right), float(left)
