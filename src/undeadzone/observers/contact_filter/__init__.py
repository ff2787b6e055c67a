"""Contact filter."""
