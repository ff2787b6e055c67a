"""What several observers of the literature share."""
