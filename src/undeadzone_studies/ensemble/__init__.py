"""Ensembles, many runs of one scenario: uncertain parameters, computation, storage and
statistics.
"""
