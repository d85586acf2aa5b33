"""The simulated spacecraft: parameters, state, and the tick that Basilisk would have run."""
