"""A mission's processes on this machine: which they are, where they listen, how they start and end."""
