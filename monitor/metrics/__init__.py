"""The metrics of a fleet: received bytes in, metrics of one moment out; no clock, no socket, no file."""
