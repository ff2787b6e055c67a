"""Proofs and identifiability from matrices and schedules alone."""
