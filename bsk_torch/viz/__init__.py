"""Pictures with matplotlib: how learning went, and what a policy does."""
