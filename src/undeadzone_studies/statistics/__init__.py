"""Intervals, sampling designs and sensitivities of independent runs."""
