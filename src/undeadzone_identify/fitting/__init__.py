"""Maximum likelihood estimates of any numbers of a scenario, from logs."""
