"""Engines that run a graph `next, out = step(s, w, p)` over time, without knowledge of control."""
