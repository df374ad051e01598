"""Rehearsal: every process of a mission on one virtual clock and a network in memory."""
