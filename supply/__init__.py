"""What undeadzone is made of: `python -m supply hashes`, `sbom WHEEL` and `sizes`."""
