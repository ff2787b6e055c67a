"""Figures and pages: they take results and know nothing of how those came about."""
