"""The arena: every method on every scenario, under the same conditions (docs/arena.md)."""
