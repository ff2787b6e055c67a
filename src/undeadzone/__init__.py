"""Adaptive observers for plants with a dead zone or backlash in the sensor.

The public names stand in `__init__.pyi`. Each is imported when it is first used. Names that other
packages register are found, too, and options of their methods by the name of the class. `dir` and
completion show the names that a beginner needs. The other names exist as well, and in `observers`,
`controllers`, `compensators`, `signals` and `plants`.
"""

from typing import Any

import lazy_loader

__version__ = "0.2.0"
_own, _, __all__ = lazy_loader.attach_stub(__name__, __file__)
_PUBLIC_NAMES = """
Plant Model Sensor Actuator Scenario Simulation Units Sine Step Trapezoid Random
Auto Censored Certified Extended Kalman Luenberger
StateFeedback LinearController LQG LQR PID ComputedTorque
read simulate compare identify estimate check design tune run_ensemble replay_run export plot
from_control from_scipy deadzone_update Online Run Estimation Identified InputError UndeadzoneError
observers controllers compensators signals plants
"""


def __dir__() -> list[str]:
    """Return the names for a first hour, and the packages of the remaining names."""
    return [*_PUBLIC_NAMES.split(), "__version__", "__doc__"]


def __getattr__(name: str) -> Any:
    """Return a public name, or a name that a package registers.

    Raises:
        AttributeError: no such name.
    """
    if name in __all__ or name.startswith("_"):
        return _own(name)
    from undeadzone.registry import find_registered_name

    return find_registered_name(name)
