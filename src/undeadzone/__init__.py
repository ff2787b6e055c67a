"""undeadzone: sees through a sensor's dead zone. The names here are listed in __init__.pyi and imported when used."""

import lazy_loader

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
