"""Models of a plant and its nonlinearity, each with likelihood and fit."""
