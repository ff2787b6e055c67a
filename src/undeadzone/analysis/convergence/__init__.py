"""Decay rates of the errors along a reference."""
