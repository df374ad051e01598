"""How ROS 2 spells things: messages in CDR, names on Zenoh, tokens."""
