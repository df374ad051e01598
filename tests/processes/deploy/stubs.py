"""Small scripts in place of the processes of a run: some end on SIGTERM, some ignore it."""

from __future__ import annotations

import sys
import time

import psutil

from formation.deploy.local.plan import Part, Program

READY = "say('ready')"
PRELUDE = """
import json, os, signal, sys, time
def say(event, **more): print(json.dumps({"event": event, **more}), flush=True)
def on_term(act): signal.signal(signal.SIGTERM, lambda *_: act())
def until_told(then="", **more):
    told = []
    on_term(lambda: told.append(1))
    say("ready", **more); exec(then)
    while not told: time.sleep(0.01)
"""
GOOD = "until_told(); say('summary', published={'a/odom': 3}); sys.exit(0)"
DEAF = f"signal.signal(signal.SIGTERM, signal.SIG_IGN); {READY}; time.sleep(600)"


def program(code: str, name: str = "child", part: Part = "control") -> Program:
    return Program(name, part, (sys.executable, "-c", PRELUDE + code))


def is_gone(pid: int, within: float = 0.0) -> bool:
    """Whether the process has ended, or ends within `within` [s]."""
    deadline = time.monotonic() + within
    while True:
        try:
            if psutil.Process(pid).status() == psutil.STATUS_ZOMBIE:
                return True
        except psutil.NoSuchProcess:
            return True
        if time.monotonic() >= deadline:
            return False
        time.sleep(0.02)
