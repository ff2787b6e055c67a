"""Plants of these loops."""
