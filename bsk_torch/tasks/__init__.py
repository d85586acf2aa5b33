"""Tasks that are not part of the core: each folder holds everything about one, and can be left out."""
