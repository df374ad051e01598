"""Checks of a mission before any robot moves."""
