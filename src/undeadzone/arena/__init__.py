"""The arena: every method on every scenario, on the same ground (docs/arena.md)."""
