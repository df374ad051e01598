"""Where the robot is, and whether it moves as commanded."""
