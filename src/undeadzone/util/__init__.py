"""Numbers in, files out, trees of numbers."""
