"""Controllers of the literature: one file each."""
