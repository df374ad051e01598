"""Simulation of many robots at once, without a network."""
