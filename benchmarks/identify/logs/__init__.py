"""Logs with known truth."""
