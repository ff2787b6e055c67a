"""The targets along which a reference is followed exactly."""
