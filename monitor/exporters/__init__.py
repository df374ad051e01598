"""The same metrics for other tools."""
