"""What one does with environments: planners, bounds, risks, audits, offline data, suites, and flights on Basilisk."""
