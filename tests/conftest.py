"""Shared by all tests: hypothesis without deadlines, since machines are slow at times."""

from hypothesis import HealthCheck, settings

from tools import pytest_terminal_summary as pytest_terminal_summary

settings.register_profile(
    "shared", deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True
)
settings.load_profile("shared")
