"""Programs for those who work on undeadzone: inputs, mutants, what it is made of."""
