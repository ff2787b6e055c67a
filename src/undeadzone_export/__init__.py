"""Export of a scenario's observer and controller, to run without undeadzone (docs/export.md).

As C for a microcontroller, as text for a PLC, as an FMU, a Python module, a page with sliders. The
public names stand in `__init__.pyi`. `undeadzone` has them, too.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
