"""Data on board, whole or in partitions."""
