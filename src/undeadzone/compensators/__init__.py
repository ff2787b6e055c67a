"""Compensators of an actuator's dead zone, a file for each.

The names stand in `__init__.pyi`. Compensators that other packages register are found here too.
"""

from undeadzone.registry import COMPENSATORS, attach_package

__getattr__, __dir__, __all__ = attach_package(__name__, __file__, COMPENSATORS)
