"""Problems for filters: plants, readings and the true values."""
