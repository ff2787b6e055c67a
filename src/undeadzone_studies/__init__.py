"""Studies of a scenario in many runs: ensembles, and parameters tuned by simulation.

The public names stand in `__init__.pyi`; `undeadzone` has them, too.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
