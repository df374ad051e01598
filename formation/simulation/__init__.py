"""Many robots at once, without a network."""
