"""Plants as pure functions, linear, by formulas, or robot arms."""
