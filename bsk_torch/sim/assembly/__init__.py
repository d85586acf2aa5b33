"""From models and arguments to what all simulations of satellites of one type share."""
