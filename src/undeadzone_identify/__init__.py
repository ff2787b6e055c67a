"""Identification of a real plant and its nonlinearity from a log (t, u, y), with intervals.

Nonlinearities that hide the output are fitted and judged: a dead zone, a play, friction, a servo
behind gears. The public names stand in `__init__.pyi`; `undeadzone` has them, too.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
