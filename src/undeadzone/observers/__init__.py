"""Observers that the tool recommends, a file for each (docs/which.md).

The names stand in `__init__.pyi`. Observers that other packages register are found here too.
"""

from undeadzone.registry import OBSERVERS, attach_package

__getattr__, __dir__, __all__ = attach_package(__name__, __file__, OBSERVERS)
