"""The rules of a rehearsal: what must hold, checked while it runs."""
