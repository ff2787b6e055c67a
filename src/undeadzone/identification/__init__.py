"""From a log (t, u, y) of a real plant to the widths of its sensor's dead zone, with intervals."""
