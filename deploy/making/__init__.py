"""Missions that are made or changed by a command: what is drafted, who goes where, and the file."""
