"""Missions made or changed by a command: the draft, the assignment of slots, and the file."""
