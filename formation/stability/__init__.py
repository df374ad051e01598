"""What can be said of a mission before anything moves."""
