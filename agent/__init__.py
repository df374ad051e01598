"""The process that drives one robot: law, failsafe and loop; and the simulated robot that stands in for hardware."""
