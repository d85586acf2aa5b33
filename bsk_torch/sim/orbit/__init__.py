"""Future positions of satellites: arcs solved ahead of the simulation."""
