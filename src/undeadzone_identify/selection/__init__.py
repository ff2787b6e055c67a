"""What a log shows: orders, delays, which nonlinearity, where, how wide."""
