"""What all processes of a formation share: mathematics, mission and messages."""
