"""Methods of the literature, and the contest between all methods (docs/arena.md).

They are registered as any other package's: `method = "ekf"` in a scenario finds them. The public
names stand in `__init__.pyi`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
