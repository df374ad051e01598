"""Recordings: written as a ROS 2 bag in MCAP, repaired, and read again."""
