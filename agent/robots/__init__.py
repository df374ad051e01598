"""Robots that exist only here: they speak as a real one does, so an agent cannot tell the difference."""
