"""The failsafe table, stops, the scanner's zones and the last step before the motors."""
