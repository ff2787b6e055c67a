"""Gains of a scenario: their assessment, and their search under a certificate."""
