"""How soon robots stand when something of a leader that is driven by hand fails."""
