"""Numerical methods without knowledge of control."""
