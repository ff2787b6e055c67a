"""The compensators of an actuator's dead zone: one file each.

The names stand in `__init__.pyi`; compensators that other packages register are found here too.
"""

from undeadzone.registry import COMPENSATORS, attached

__getattr__, __dir__, __all__ = attached(__name__, __file__, COMPENSATORS)
