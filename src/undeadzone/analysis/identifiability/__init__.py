"""Which widths the readings can tell."""
