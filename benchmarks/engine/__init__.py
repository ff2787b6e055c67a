"""Simulation and live steps: speed, precision and cost, beside other programs."""
