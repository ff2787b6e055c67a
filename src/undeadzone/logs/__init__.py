"""Logs of a plant as they were recorded: dialects of CSV, names of columns, steps, other files."""
