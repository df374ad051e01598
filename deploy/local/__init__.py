"""A mission's processes on this machine: their list, endpoints, start and end."""
