"""undeadzone: sees through a sensor's dead zone."""

__version__ = "0.1.0"
