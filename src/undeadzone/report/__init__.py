"""Figures and pages of results, independent of the computation of the results."""
