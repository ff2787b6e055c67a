"""Numerical methods that know nothing of control."""
