"""What was heard, kept: written as a ROS 2 bag in MCAP, mended, and read again."""
