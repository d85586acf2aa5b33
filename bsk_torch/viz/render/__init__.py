"""Pictures of the present moment of an environment."""
