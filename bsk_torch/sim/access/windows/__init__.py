"""Windows of satellites over places."""
