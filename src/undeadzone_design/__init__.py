"""Design of certified gains: assessment of a scenario's gains, and search for better ones.

The public names stand in `__init__.pyi`; `undeadzone` has them, too.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
