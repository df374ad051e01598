"""Simulated robots: they send and receive as a real one does, so an agent cannot tell the difference."""
