"""Closed loops with backlash, or with dead zones at both ends."""
