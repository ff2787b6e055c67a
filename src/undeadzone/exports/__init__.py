"""What runs elsewhere: a scenario's observer, and its controller, as C99 (docs/export.md)."""
