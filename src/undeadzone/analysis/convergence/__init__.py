"""Decay rates of the errors, and searches for growing errors."""
