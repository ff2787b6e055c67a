"""Identification from logs: classes, widths, gaps and time."""
