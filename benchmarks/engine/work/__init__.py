"""The work that every engine does."""
