"""The `formation` command, the launcher, missions, and the environment."""
