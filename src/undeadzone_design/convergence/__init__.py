"""Searches for errors that grow, and trajectories of the errors along a reference."""
