"""Commands of studies: `undeadzone ensemble` and `undeadzone tune`."""
