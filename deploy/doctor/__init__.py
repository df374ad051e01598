"""`formation doctor`: gather facts about robots and name faults, without moving anything.

Gathering (`at_robot`, `at_desk`, `probe`, `files`, `machine`) and judging are separate: every examination is
a function from `facts.Facts` to findings.
"""
