"""Parameters of observer and controller, tuned by simulation."""
