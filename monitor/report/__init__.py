"""A recording made into figures and a page for a paper."""
