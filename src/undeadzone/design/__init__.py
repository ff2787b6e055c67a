"""What can be computed before anything runs: gains, certificates, structure. Each answer carries its residual."""
