"""Exported C: size, cost, precision, bad readings."""
