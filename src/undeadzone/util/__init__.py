"""Checked numbers, files, trees of numbers and text."""
