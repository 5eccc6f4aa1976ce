"""What changed between two logs of one machine, whatever its model gets wrong in both; the theory page derives it.

Modules import only those before them: `windows` has likelihoods of rows; `candidates` are what may have changed, `law`
what else differs, `strengths` by how much; `question` is the regression of two logs, which `mixups` doubts, `telling`
words, and `search` answers.
"""

from skat.diagnosis.changes.search import find_changes
from skat.diagnosis.changes.telling import Changes

__all__ = ["Changes", "find_changes"]
