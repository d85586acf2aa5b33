"""Geometry of visibility along planned orbits: umbra, ground track, and passes over places on the ground."""
