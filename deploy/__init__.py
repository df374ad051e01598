"""What puts the processes in place: the `formation` command, the launcher, missions, the environment."""
