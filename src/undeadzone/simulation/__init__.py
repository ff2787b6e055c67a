"""One run: the loop closed, its inputs, its result."""
