"""A recorded run lived through again: does an agent that is given the same inputs say the same?"""
