"""Output of commands in a terminal, and their keys."""
