"""Lines of sight between satellites."""
