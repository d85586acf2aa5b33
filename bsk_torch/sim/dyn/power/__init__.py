"""Battery and solar panels."""
