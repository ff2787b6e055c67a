"""Registry of methods by name: the tool's own, and methods registered by other installed packages.

A package registers an observer by a line in its `pyproject.toml`:

    [project.entry-points."undeadzone.observers"]
    held = "my_package.held:Held"

`method = "held"` then stands in scenario files. Only the module that is named is imported.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple, Protocol, runtime_checkable

import lazy_loader
import msgspec

from undeadzone.errors import InputError
from undeadzone.util import arrays
from undeadzone.util.installed import list_registered_places, load_object
from undeadzone.util.toml import OptionTable, advise_on_name

if TYPE_CHECKING:
    from undeadzone.interfaces import Compensator, Controller, Observer
    from undeadzone.nonlinearities.actuator import Belief
    from undeadzone.nonlinearities.sensor import Zone
    from undeadzone.plants.system import System


class Options(OptionTable, frozen=True, tag_field="method"):
    """Options of an observer, a controller or a compensator, and the method that they build.

    `build(model, ...)` takes the model that the method computes with, for an observer the dead zone
    as the observer takes it, for a compensator the knowledge about the actuator. It raises
    InputError for an option that it cannot take or a model that it is not for, ShapeError for an
    option of another shape, StructureError for a model on which the method does not exist, and
    StepError for a step that is too coarse for it.
    """


@runtime_checkable
class ObserverOptions(Protocol):
    """Options of an observer."""

    __struct_config__: ClassVar[Any]
    __struct_fields__: ClassVar[tuple[str, ...]]

    def build(self, model: System, sensor: Zone) -> Observer:
        """Return the observer for a model."""


@runtime_checkable
class ControllerOptions(Protocol):
    """Options of a controller."""

    __struct_config__: ClassVar[Any]

    def build(self, model: System) -> Controller:
        """Return the controller for a model."""


@runtime_checkable
class CompensatorOptions(Protocol):
    """Options of a compensator of an actuator."""

    __struct_config__: ClassVar[Any]

    def build(self, model: System, belief: Belief | None) -> Compensator:
        """Return the compensator for a model and the knowledge about its actuator."""


class _Tagged(msgspec.Struct):
    """Table reduced to the key that names its method.

    Attributes:
        method: its tag.
    """

    method: str


class Registry(NamedTuple):
    """Methods of a kind: observers, controllers or compensators.

    Attributes:
        group: the entry points by which other packages register theirs.
        own: places of the tool's own options, `module:Class`, by method.
    """

    group: str
    own: Mapping[str, str]

    def list_tags(self) -> list[str]:
        """Return the names of all methods, the tool's own first."""
        return [*self.own, *list_registered_places(self.group)]

    def find_options(self, tag: str) -> type[Options] | None:
        """Return the class of the options of a method, or None if the name is unknown.

        Raises:
            InputError: the package that registered it cannot be imported, or registers no options.
        """
        place = self.own.get(tag) or list_registered_places(self.group).get(tag)
        if place is None:
            return None
        options = load_object(f"{self.group}: {tag!r}", place)
        is_struct = isinstance(options, type) and issubclass(options, msgspec.Struct)
        if not is_struct or not hasattr(options, "build"):
            raise InputError(
                f"{self.group}: {tag!r} is registered at {place}, which is not a class of options. "
                "Derive it from undeadzone.registry.Options, with a method build"
            )
        return options

    def has_options(self, options: type) -> bool:
        """Return whether options of this class are of this kind."""
        place = f"{options.__module__}:{options.__name__}"
        if options.__module__.startswith("undeadzone."):  # no package registers those
            return place in self.own.values()
        return place in list_registered_places(self.group).values()

    def list_options(self) -> list[type[Options]]:
        """Return the options classes of all methods, except of packages that cannot be
        imported.
        """
        found = []
        for tag in self.list_tags():
            with suppress(InputError):
                found.append(self.find_options(tag))
        return [options for options in found if options is not None]

    def create_options(self, tag: str, **options: Any) -> Any:
        """Return options of a method of the tool's own.

        Args:
            tag: the method.
            options: options that differ from their defaults.
        """
        return load_object(tag, self.own[tag])(**options)

    def decode_options(self, table: Any) -> Any:
        """Return options from a table of a scenario, by its key `method`. A struct stays
        unchanged.

        Raises:
            ValueError: in msgspec's words, for a table that has no such method or no such keys.
            InputError: the package that registered the method cannot be imported.
        """
        if isinstance(table, msgspec.Struct):
            return table
        try:
            tag = msgspec.convert(table, _Tagged).method
            options = self.find_options(tag)
            if options is None:
                raise ValueError(f"Invalid value {tag!r} - at `$.method`")
            return msgspec.convert(table, options, dec_hook=arrays.decode_array)
        except msgspec.ValidationError as error:
            raise ValueError(str(error)) from None


OBSERVERS: Final = Registry(
    "undeadzone.observers",
    {
        "auto": "undeadzone.observers.auto:Auto",
        "certified": "undeadzone.observers.certified:Certified",
        "kalman": "undeadzone.observers.kalman:Kalman",
        "censored": "undeadzone.observers.censored:Censored",
        "extended": "undeadzone.observers.extended:Extended",
        "contact": "undeadzone.observers.contact:Contact",
        "luenberger": "undeadzone.observers.luenberger:Luenberger",
        "oracle": "undeadzone.observers.oracle:Oracle",
        "full_state": "undeadzone.observers.full_state:FullState",
        "high_gain": "undeadzone.observers.high_gain:HighGain",
    },
)
CONTROLLERS: Final = Registry(
    "undeadzone.controllers",
    {
        "state_feedback": "undeadzone.controllers.state_feedback:StateFeedback",
        "pd": "undeadzone.controllers.pd:PD",
        "pid": "undeadzone.controllers.pid:PID",
        "lqr": "undeadzone.controllers.lqr:LQR",
        "lqg": "undeadzone.controllers.lqg:LQG",
        "linear": "undeadzone.controllers.linear_controller:LinearController",
        "computed_torque": "undeadzone.controllers.computed_torque:ComputedTorque",
    },
)
COMPENSATORS: Final = Registry(
    "undeadzone.compensators",
    {
        "none": "undeadzone.compensators.no_inverse:NoInverse",
        "inverse": "undeadzone.compensators.zone_inverse:ZoneInverse",
        "play_inverse": "undeadzone.compensators.play_inverse:PlayInverse",
        "smooth_inverse": "undeadzone.compensators.smooth_inverse:SmoothZoneInverse",
    },
)
REGISTRIES: Final[Mapping[Any, Registry]] = {
    ObserverOptions: OBSERVERS,
    ControllerOptions: CONTROLLERS,
    CompensatorOptions: COMPENSATORS,
}


def decode_field(kind: type, value: Any) -> Any:
    """Return options of methods or arrays from tables of a scenario (the decode hook of msgspec).

    Raises:
        ValueError: an impossible value (msgspec adds its place).
        InputError: the package that registered a method cannot be imported.
    """
    catalogue = REGISTRIES.get(kind)
    return (
        arrays.decode_array(kind, value) if catalogue is None else catalogue.decode_options(value)
    )


def attach_package(package: str, file: str, *catalogues: Registry) -> tuple[Any, Any, list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package whose names are in its stub.

    Args:
        package: its `__name__`.
        file: its `__file__`.
        catalogues: whose options are found by the names of their classes too.
    """
    own, listed, names = lazy_loader.attach_stub(package, file)

    def get(name: str) -> Any:
        """Return a name of the stub, or the options of a class name."""
        if name in names or not name[:1].isupper():
            return own(name)
        return find_options_class(name, *catalogues)

    return get, listed, names


def find_registered_name(name: str) -> Any:
    """Return the object registered under `undeadzone.names`, or the options of a method.

    Args:
        name: by which it is registered, or of the options' class.

    Raises:
        AttributeError: there is none.
        InputError: the package that registered it cannot be imported.
    """
    place = list_registered_places("undeadzone.names").get(name)
    return find_options_class(name) if place is None else load_object(f"undeadzone.{name}", place)


def find_options_class(name: str, *catalogues: Registry) -> type[Options]:
    """Return the class of options with a given class name.

    Args:
        name: of the class.
        catalogues: registries to search (default all).

    Raises:
        AttributeError: there are none.
    """
    known = []
    for catalogue in catalogues or REGISTRIES.values():
        for place in [*catalogue.own.values(), *list_registered_places(catalogue.group).values()]:
            known.append(place.rpartition(":")[2])
            if known[-1] == name:
                return load_object(f"{catalogue.group}: {name}", place)
    advice = advise_on_name(name, known, "?").partition("? ")[0]
    words = f"undeadzone has no {name!r}, and no package registers such options"
    raise AttributeError(f"{words}. {advice}".removesuffix(". "))
