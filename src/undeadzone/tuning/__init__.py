"""Numbers of observer and controller found by simulation."""
