"""The live page: a small web server beside the monitor, and what it serves."""
