"""Observers of the literature: one file each."""
