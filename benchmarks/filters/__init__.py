"""Filters of sensors with a dead zone: coverage, errors, tests of assumptions."""
