"""Figures and a page, for a paper, from a recording."""
