"""`formation doctor`: gathers facts about robots, moves nothing, and names what is wrong.

Gathering (`at_robot`, `at_desk`, `probe`, `files`, `machine`) and judging are apart: every examination is a
function from `facts.Facts` to findings.
"""
