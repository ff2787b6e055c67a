"""Answer in the units of the log: values, words, a scenario."""
