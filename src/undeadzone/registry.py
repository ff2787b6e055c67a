"""Methods by name: the tool's own, and those that other installed packages register.

A package registers an observer by a line in its `pyproject.toml`:

    [project.entry-points."undeadzone.observers"]
    held = "my_package.held:Held"

`method = "held"` then stands in scenario files. Only the module that is named is imported.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple, Protocol, runtime_checkable

import lazy_loader
import msgspec

from undeadzone.errors import InputError
from undeadzone.util import arrays

if TYPE_CHECKING:
    from undeadzone.interfaces import Compensator, Controller, Observer
    from undeadzone.nonlinearities.actuator import Belief
    from undeadzone.nonlinearities.sensor import Zone
    from undeadzone.plants.system import System


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="method"):
    """Options of an observer, a controller or a compensator, and the method that they build.

    `build(model, ...)` takes the model that the method computes with, for an observer the dead zone
    as the observer takes it, for a compensator what is known of the actuator. It raises InputError
    for an option that it cannot take or a model that it is not for, ShapeError for an option of
    another shape, StructureError for a model on which the method does not exist, and StepError for
    a step that is too coarse for it.
    """


@runtime_checkable
class ObserverOptions(Protocol):
    """Options of an observer."""

    __struct_config__: ClassVar[Any]

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
        """Return the compensator for a model and what is known of its actuator."""


class _Tagged(msgspec.Struct):
    """A table as far as it names its method.

    Attributes:
        method: its tag.
    """

    method: str


class Registry(NamedTuple):
    """The methods of one kind.

    Attributes:
        group: the entry points by which other packages register theirs.
        own: where the tool's own options stand, `module:Class`, by method.
    """

    group: str
    own: Mapping[str, str]

    def tags(self) -> list[str]:
        """Return every method's name, the tool's own first."""
        return [*self.own, *_registered_places(self.group)]

    def options(self, tag: str) -> type[Options] | None:
        """Return the options of a method; None where there is none of this name.

        Raises:
            InputError: the package that registered it cannot be imported, or registers no options.
        """
        place = self.own.get(tag) or _registered_places(self.group).get(tag)
        if place is None:
            return None
        options = _load_object(f"{self.group}: {tag!r}", place)
        is_struct = isinstance(options, type) and issubclass(options, msgspec.Struct)
        if not is_struct or not hasattr(options, "build"):
            raise InputError(
                f"{self.group}: {tag!r} is registered at {place}, which is no class of options; "
                "derive it from undeadzone.registry.Options, with a method build"
            )
        return options

    def has(self, options: type) -> bool:
        """Return whether options of this class are of this kind."""
        place = f"{options.__module__}:{options.__name__}"
        if options.__module__.startswith("undeadzone."):  # no package registers those
            return place in self.own.values()
        return place in _registered_places(self.group).values()

    def every(self) -> list[type[Options]]:
        """Return the options of every method, but of those whose package cannot be imported."""
        found = []
        for tag in self.tags():
            with suppress(InputError):
                found.append(self.options(tag))
        return [options for options in found if options is not None]

    def create(self, tag: str, **options: Any) -> Any:
        """Return options of one of the tool's own methods.

        Args:
            tag: the method.
            options: what is not as it is by default.
        """
        return _load_object(tag, self.own[tag])(**options)

    def decode_options(self, table: Any) -> Any:
        """Return options from a table of a scenario, by its key `method`; a struct stays as it is.

        Raises:
            ValueError: in msgspec's words, for a table that has no such method or no such keys.
            InputError: the package that registered the method cannot be imported.
        """
        if isinstance(table, msgspec.Struct):
            return table
        try:
            tag = msgspec.convert(table, _Tagged).method
            options = self.options(tag)
            if options is None:
                raise ValueError(f"Invalid value {tag!r} - at `$.method`")
            return msgspec.convert(table, options, dec_hook=arrays.decode)
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
        "smooth_inverse": "undeadzone.compensators.smooth_inverse:SmoothZoneInverse",
    },
)
CATALOGUES: Final[Mapping[Any, Registry]] = {
    ObserverOptions: OBSERVERS,
    ControllerOptions: CONTROLLERS,
    CompensatorOptions: COMPENSATORS,
}


def decode(kind: type, value: Any) -> Any:
    """What msgspec asks of a scenario's tables for: options of methods, and arrays.

    Raises:
        ValueError: what a value cannot be; msgspec says where.
        InputError: the package that registered a method cannot be imported.
    """
    catalogue = CATALOGUES.get(kind)
    return arrays.decode(kind, value) if catalogue is None else catalogue.decode_options(value)


def attach_package(package: str, file: str, *catalogues: Registry) -> tuple[Any, Any, list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package whose names stand in its stub.

    Args:
        package: its `__name__`.
        file: its `__file__`.
        catalogues: whose options are found by the names of their classes too.
    """
    own, listed, names = lazy_loader.attach_stub(package, file)

    def get(name: str) -> Any:
        if name in names or not name[:1].isupper():
            return own(name)
        return options_named(name, *catalogues)

    return get, listed, names


def registered_name(name: str) -> Any:
    """What a package registers under `undeadzone.names`, or the options of a method.

    Args:
        name: by which it is registered, or of the options' class.

    Raises:
        AttributeError: there is none.
        InputError: the package that registered it cannot be imported.
    """
    place = _registered_places("undeadzone.names").get(name)
    return options_named(name) if place is None else _load_object(f"undeadzone.{name}", place)


def options_named(name: str, *catalogues: Registry) -> type[Options]:
    """Return the options of which the class has a name.

    Args:
        name: of the class.
        catalogues: where to look; default all.

    Raises:
        AttributeError: there are none.
    """
    for catalogue in catalogues or CATALOGUES.values():
        for place in [*catalogue.own.values(), *_registered_places(catalogue.group).values()]:
            if place.rpartition(":")[2] == name:
                return _load_object(f"{catalogue.group}: {name}", place)
    raise AttributeError(f"undeadzone has no {name!r}, and no package registers such options")


def _registered_places(group: str) -> dict[str, str]:
    """Where other packages' options stand, by method; read again once a package is installed."""
    folders = filter(os.path.isdir, map(os.path.abspath, sys.path))
    return _places_of_group(
        group, tuple((folder, os.stat(folder).st_mtime_ns) for folder in folders)
    )


@functools.lru_cache
def _places_of_group(group: str, searched: tuple[tuple[str, int], ...]) -> dict[str, str]:
    """Where options stand, by method, while the folders searched are as old as they were."""
    from importlib.metadata import entry_points

    return {point.name: point.value for point in entry_points(group=group)}


def _load_object(what: str, place: str) -> Any:
    """What stands at `module:Class`. Raises InputError."""
    module, _, name = place.partition(":")
    try:
        return getattr(import_module(module), name)
    except Exception as error:
        raise InputError(f"{what} is registered at {place}, which fails: {error}") from None
