"""Messages between processes, as typed values: so far their status."""
