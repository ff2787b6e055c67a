"""Arms and servos behind gears with gaps, by the filter `contact`."""
