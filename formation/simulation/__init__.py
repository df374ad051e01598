"""Many robots as arrays, without a network."""
