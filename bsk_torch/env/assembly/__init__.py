"""From satellites and options to simulations: types, fleets, trial episodes."""
