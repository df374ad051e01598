"""The mission: its model, its rules, its file."""
