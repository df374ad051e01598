"""The process that leads: routes, orders and their loop."""
