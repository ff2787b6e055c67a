"""Benchmarks, one module each with `table() -> str` (Markdown).

`python -m benchmarks [NAME ...]` runs them.
"""
