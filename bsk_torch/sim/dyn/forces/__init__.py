"""Forces on the body: gravity, drag, sunlight, and those of users."""
