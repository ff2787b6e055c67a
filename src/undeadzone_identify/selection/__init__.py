"""Decision on a log: orders, delays, the nonlinearity, its location, its widths."""
