"""Adaptive observers: adaptation laws, gains and output-error injection."""
