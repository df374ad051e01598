"""Run the agents of a recording again: do they send the same commands for the same inputs?"""
