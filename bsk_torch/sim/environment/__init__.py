"""The Sun, the Earth, ground stations and the atmosphere."""
