"""Models of a plant and what stands beside it, each with its likelihood and its fit."""
