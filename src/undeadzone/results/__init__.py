"""Results: signals, what is known of them, how they are said and kept."""
