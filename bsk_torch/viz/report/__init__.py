"""The report of a training as a web page."""
