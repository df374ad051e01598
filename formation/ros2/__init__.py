"""ROS 2 on the wire: messages in CDR, names on Zenoh, tokens."""
