"""What every process of a formation shares: the mathematics, the mission and the words on the wire."""
