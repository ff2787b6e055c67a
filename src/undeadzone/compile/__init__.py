"""Engines run a graph `next, out = step(s, w, p)` over time; they know nothing of control."""
