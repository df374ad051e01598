"""The process that drives one robot; and the simulated robot that replaces hardware."""
