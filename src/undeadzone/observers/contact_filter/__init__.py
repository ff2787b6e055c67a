"""Contact filter: an extended Kalman filter for each combination of gear contacts."""
