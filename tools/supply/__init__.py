"""What undeadzone is made of: `python -m tools.supply hashes`, `sbom WHEEL` and `sizes`."""
