"""Logs as recorded, on their grid, and made ready for a fit."""
