"""Gains of a scenario: assessed, and found by a search, under a certificate."""
