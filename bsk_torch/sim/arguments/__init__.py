"""Arguments of satellites and world: what users give, its conversion to tensors, and draws."""
