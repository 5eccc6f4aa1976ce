"""Many logs at once: each diagnosed by itself, all of them in one table, and what changed on a robot over time."""

from skat.fleet.drifts import drifts_of
from skat.fleet.many import Fleet, diagnose_many

__all__ = ["Fleet", "diagnose_many", "drifts_of"]
