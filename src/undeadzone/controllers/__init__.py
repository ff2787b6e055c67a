"""Controllers that the tool recommends, a file for each (docs/which.md).

The names stand in `__init__.pyi`. Controllers that other packages register are found here too.
"""

from undeadzone.registry import CONTROLLERS, attach_package

__getattr__, __dir__, __all__ = attach_package(__name__, __file__, CONTROLLERS)
