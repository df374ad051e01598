"""Buses, processes and links: all of formation that touches a clock, a socket or Zenoh."""
