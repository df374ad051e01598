"""Replay of a recording."""
