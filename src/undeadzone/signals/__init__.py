"""References, disturbances, paths and noise."""
