"""Adaptive observers that see through a sensor's dead zone.

The public names stand in `__init__.pyi`; each is imported when it is first used. Options of methods
that other packages register are found by the name of their class, too.
"""

from typing import Any

import lazy_loader

__version__ = "0.1.0"
_own, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """A public name, or registered options. Raises AttributeError."""
    if name in __all__ or not name[:1].isupper():
        return _own(name)
    from undeadzone.catalogue import options_named

    return options_named(name)
