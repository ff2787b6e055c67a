"""Ensembles: one scenario, many runs; what varies, how it is computed, kept and judged."""
