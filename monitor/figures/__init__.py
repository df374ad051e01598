"""What is known of a fleet: bytes of the wire in, figures of one moment out; no clock, no socket, no file."""
