"""Pictures of the current moment of an environment."""
