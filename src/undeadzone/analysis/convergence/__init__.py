"""How fast errors die, and attempts to make them grow."""
