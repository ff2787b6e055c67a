"""Certificates of sets of models, of models with errors and inputs, and the nearest gains."""
