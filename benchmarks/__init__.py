"""Benchmarks by subject. A module with `table() -> str` (Markdown) is a bench, its file the name.

`python -m benchmarks [NAME ...]` runs them.
"""
