"""Points on the surface of a spacecraft that others inspect: when each is seen and lit, computed for whole runs."""
