"""What an agent saves, restores and traces."""
