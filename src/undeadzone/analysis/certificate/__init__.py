"""Certificates: a common V that never rises, for every sequence of branches."""
