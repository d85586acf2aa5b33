"""The simulation below the environments."""
