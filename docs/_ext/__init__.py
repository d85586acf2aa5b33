"""Extensions of Sphinx, and what the pages are generated with."""
