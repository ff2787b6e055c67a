"""Identifiability of the widths from readings."""
