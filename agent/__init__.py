"""The process that drives one robot; and the simulated robot that stands in for hardware."""
