"""The controllers that the tool recommends: one file each (docs/which.md).

The names stand in `__init__.pyi`; controllers that other packages register are found here too.
"""

from undeadzone.registry import CONTROLLERS, attached

__getattr__, __dir__, __all__ = attached(__name__, __file__, CONTROLLERS)
