"""Commands about gains: `undeadzone check` and `undeadzone design`."""
