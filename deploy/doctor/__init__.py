"""`formation doctor`: gather facts about robots and name faults, without moving anything.

Gathering (`gather`, `tls`) and judging (`agent`, `robot`) are separate: every examination is a function from
`facts.Facts` to findings.
"""
