"""The comparison of all methods: regret and effort."""
