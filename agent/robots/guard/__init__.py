"""The guard: a process of its own that stops a robot whose agent died, hangs or is cut off."""
