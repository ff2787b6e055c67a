"""Filters of other programs, and filters in plain NumPy."""
