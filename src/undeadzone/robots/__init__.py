"""Robot arms: what they are made of, how they move, the paths that they follow."""
