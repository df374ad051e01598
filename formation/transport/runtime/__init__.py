"""The common parts of every process around its core: flags, clock, signals, systemd."""
