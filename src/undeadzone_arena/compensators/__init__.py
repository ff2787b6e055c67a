"""Compensators of the literature: one file each."""
