"""Everything that puts the processes in place: the `formation` command, the local launcher, missions, the environment."""
