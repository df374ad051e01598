"""What a robot sees of its neighbours with its own range scanner, and the pose that follows from it."""
