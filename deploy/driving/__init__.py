"""`formation drive`: a leader driven by hand, with keys, a gamepad or a ROS topic."""
