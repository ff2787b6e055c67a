"""One HTML file in which a scenario's loop runs: `undeadzone export --to page` (docs/export.md)."""
