"""The watchdog: a separate process that stops a robot if its agent died, hangs or is cut off."""
