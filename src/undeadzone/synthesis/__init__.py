"""Gains judged, and found, under a certificate."""
