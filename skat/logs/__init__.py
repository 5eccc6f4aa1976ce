"""Measured logs, from whatever file they are in, as transitions of a simulator.

`load_log` reads; a `Log` is what comes out; `LogError` is what is raised, with the place and the remedy.
"""

from skat.logs.errors import LogError
from skat.logs.loading import load_log
from skat.logs.log import Log, Match, joined
from skat.logs.mapping import read_map, write_map
from skat.logs.suspects import Suspect, suspects

__all__ = ["Log", "LogError", "Match", "Suspect", "joined", "load_log", "read_map", "suspects", "write_map"]
