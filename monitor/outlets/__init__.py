"""The same figures for the tools of others."""
