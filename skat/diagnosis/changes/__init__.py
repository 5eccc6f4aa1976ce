r"""What changed between two logs of one machine, whatever its model gets wrong in both.

Missing forces are a regression on the force of every effect, as those of `forces`, of positions alone; measured speeds
are compared with those of the positions. Each log is cut into windows of time, each of which has effects of its own:

.. math:: z_b = N_b (\theta + \eta_b + [b \in \text{after}] (\Delta + \delta)) + e_b.

:math:`\theta` is what is wrong in both logs, all effects at once, held by their priors. No model is right, and what it
misses differs from motion to motion: :math:`\eta` is by how much, and T, of each effect, is estimated within the logs,
each with values of its own. :math:`\Delta` says that logs that move otherwise differ though nothing changed, in all
effects on a joint, by a strength that both logs tell. All three are integrated out, and sparse :math:`\delta`, by how
much the logs differ more than that, are searched for by evidence. The theory page derives it.

Modules import only those before them: `windows` has likelihoods of rows; `candidates` are what may have changed, `law`
what else differs, and `strengths` by how much; `question` is the regression of two logs, which `mixups` doubts,
`telling` words, and `search` answers.
"""

from skat.diagnosis.changes.search import find_changes
from skat.diagnosis.changes.telling import Changes

__all__ = ["Changes", "find_changes"]
