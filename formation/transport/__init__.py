"""Buses, processes and links: all code of formation that uses a clock, a socket or Zenoh."""
