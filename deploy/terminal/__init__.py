"""What commands show in a terminal, and the keys that they take there."""
