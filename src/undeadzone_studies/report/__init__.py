"""Figures and pages of ensembles and of tuned parameters."""
