"""Logs as recorded, on a regular grid, and prepared for a fit."""
