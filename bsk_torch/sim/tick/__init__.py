"""The tick of one type of satellites, and the loop that runs it."""
