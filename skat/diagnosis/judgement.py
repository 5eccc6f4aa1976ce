"""Whether what a search has found stands: by its size, by the fall of the loss, and by what it predicts."""

import numpy as np
from scipy import stats

from skat.diagnosis.evidence import family_p_value, grams, lone_statistics

# A cause must lower the loss of episodes, not only of the whole, at this level; from so many episodes on.
IMPROVEMENT_LEVEL = 0.02
FEWEST_EPISODES = 8
# Or blocks lose at most this share of what others gain, and no block has more than that share of the gain.
LOST_SHARE = 0.1
LARGEST_BLOCK_SHARE = 0.7
# A model predicts worse than another where its errors are larger by so many standard errors.
WORSE = 2.0


class Judgement:
    """Judges the effects of models.

    Parameters
    ----------
    estimates : Estimates
    proposals : Proposals
    """

    def __init__(self, estimates, proposals):
        self.estimates, self.proposals = estimates, proposals
        self.residuals, self.refits = estimates.residuals, estimates.refits

    def p_values(self, values, spread=None):
        """Return family-wise p-values of fitted values, given by how much each varies beside its standard error."""
        return self.in_family(values, self.estimates.p_values(values, spread))

    def in_family(self, values, p_values):
        """Return the family-wise p-values of the effects of a model, given each one's own by its size.

        An effect that has no derivative where it is neutral, as a limit that is not reached there, may be far from it
        in standard errors and explain nothing. It is judged by how well the change that it makes fits what is missing
        without it, and each of the values that were tried counts.
        """
        of_family = {}
        for name, p_value in p_values.items():
            n_tried = len(self.estimates.names)
            without = {other: value for other, value in values.items() if other != name}
            if not self.residuals.derivatives(without, [name]).any():
                p_value, n_tried = (
                    self._p_value_asleep(values, without),
                    n_tried * self.proposals.n_values(name),
                )
            of_family[name] = family_p_value(p_value, n_tried)
        return of_family

    def _p_value_asleep(self, values, without):
        missed, left = self.refits.whitened([without, values])
        change = (missed - left)[..., np.newaxis]
        statistic, _, freedom = lone_statistics(grams(missed, change, self.estimates.clusters(1)))
        return float(2 * stats.t.sf(abs(statistic[0]), freedom[0]))

    def predicts(self, values, less):
        """Whether a model predicts the next states no worse than one with less, from the states as they were measured.

        The loss is of states smoothed by the model with the noise that it leaves. A channel in which something else
        is missed passes for noisy there, and may then be given any scale. Where single steps are mostly noise, the
        measured states say little, and only what they plainly speak against is refused.
        """
        return self._worsening([values, less])[0] < WORSE

    def misleading(self, values):
        """Return the effect with which a model predicts plainly worse than without it, the most; None if none is."""
        models = {name: {other: values[other] for other in values if other != name} for name in values}
        worsening = self._worsening([values, *models.values()])
        worst = int(np.argmax(worsening))
        return list(models)[worst] if worsening[worst] >= WORSE else None

    def _worsening(self, models):
        """Return by how much the first of models predicts worse than each of the others, in standard errors."""
        errors = self.residuals.log_errors(models)
        blocks = self.residuals.blocks[self.residuals.present]
        starts = np.flatnonzero(np.r_[True, np.diff(blocks) > 0])
        worse = np.add.reduceat(errors[:1] - errors[1:], starts, axis=1)
        spread = np.sqrt(np.sum(worse**2, axis=1))
        return worse.sum(axis=1) / np.maximum(spread, 1e-150)

    def improves(self, fit, losses):
        """Whether the loss falls throughout: in episodes (blocks, where they are few), or wherever it moves at all.

        An effect that acts in few blocks, such as at impacts, passes where it lowers several of them and raises
        hardly any; what fits one row at the cost of others does not.
        """
        fall = losses - fit.losses
        gained, lost = fall[fall > 0].sum(), -fall[fall < 0].sum()
        if lost < LOST_SHARE * gained and fall.max() < LARGEST_BLOCK_SHARE * gained:
            return True
        if _by_episode(self.residuals.log):
            fall = np.bincount(self.residuals.log.episodes[self.refits.starts], fall)
        error = np.sqrt(len(fall) * fall.var(ddof=1))
        return bool(fall.sum() > least_fall(self.residuals) * error)


def least_fall(residuals):
    """Return the t, over episodes or blocks, beyond which the loss counts as lower throughout the log."""
    log = residuals.log
    n_parts = log.n_episodes if _by_episode(log) else len(np.unique(residuals.blocks))
    return float(stats.t.isf(IMPROVEMENT_LEVEL, max(n_parts - 1, 1)))


def _by_episode(log):
    return log.consecutive and log.n_episodes >= FEWEST_EPISODES
