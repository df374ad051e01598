"""Commands for recordings: replay and verify, report, recover."""
