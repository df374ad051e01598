"""Neighbours, slots, orders and gains of one robot."""
