"""Gaussian filters of the state and the widths, with innovation tests."""
