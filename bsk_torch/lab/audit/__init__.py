"""Audits of policies: regret of decisions, and explanations of deaths."""
