"""Slots: where a formation's robots belong, who takes which, and whom each of them measures."""
