"""When and how satellites see places, the Sun and one another: windows, eclipses, lines of sight, relative geometry."""
