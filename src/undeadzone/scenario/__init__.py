"""The problem in words, and as checked parts."""
