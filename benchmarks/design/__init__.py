"""Certified gains and pairs of truths with the same readings."""
