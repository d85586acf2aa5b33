"""Catalogs of objects in orbit that have neither attitude nor tick: their orbits, and what imagers see of them."""
