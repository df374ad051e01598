"""A recording played again."""
