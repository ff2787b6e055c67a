"""Servo behind gear play: predictor, likelihood, search, crossings, gap with its interval."""
