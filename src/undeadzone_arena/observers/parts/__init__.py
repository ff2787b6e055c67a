"""Parts that several observers of the literature share."""
