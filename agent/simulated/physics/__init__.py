"""Robots with mass and wheels that slip, in MuJoCo, instead of the kinematic ones; same messages."""
