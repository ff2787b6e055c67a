"""Figures and pages of gains: their certificate, decay and identifiability."""
