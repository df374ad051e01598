"""Slots: positions of robots in the formation, their assignment, and the measurement graph."""
