r"""Sets of changes, weighed where logs may differ though nothing changed, by as much as makes both logs most likely.

Of a model that is not right, two logs differ by more than noise: by what its misfit looks like in the one motion and in
the other. A change is in one effect; misfit is in all of them, on each joint by the same share of what no effect
explains there. How large that share is all of them tell together, anew for each set of changes: a variance component,
as the heterogeneity of studies [1]_, over which the marginal likelihood is summed. So a change on one joint is no
misfit as long as nothing else differs.

References
----------
.. [1] Higgins, Thompson, Spiegelhalter (2009). A re-evaluation of random-effects meta-analysis. J. R. Stat. Soc. A 172.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from skat.diagnosis.chains import Array
from skat.diagnosis.changes.law import Law
from skat.diagnosis.changes.windows import Quadratic
from skat.diagnosis.evidence import Gram, Priors, Weighed, Weigher, gains_alone
from skat.diagnosis.search import search_sets

# Of the variance of an effect's difference, over that if all misfit looked like it. No misfit exerts more than all of
# itself; logs that differ by more do so by a change.
STRENGTHS, BEYOND = np.power(8.0, np.arange(-5, 1), dtype=float), np.power(8.0, np.arange(1, 5), dtype=float)
# Precision of an effect that no joint feels, in typical sizes.
LEAST = 1e-6


@dataclass(frozen=True)
class Logs:
    """Both logs as quadratics in what is common, the second with candidates behind it, and the law of what is common.

    Attributes
    ----------
    first, second : Quadratic
        In (n_common,) and (n_common + n_candidates,) values, in units of typical sizes. What is common are effects,
        and then what only their likes in the second log are candidates for, in which logs differ by no misfit.
    law : Law
        Of effects.
    firsts, seconds : tuple of Quadratic
        The windows of each, one of which may be left out.
    strengths : ndarray of shape (n_strengths,)
        By which logs may differ, each as likely.
    """

    first: Quadratic
    second: Quadratic
    law: Law
    firsts: tuple[Quadratic, ...] = ()
    seconds: tuple[Quadratic, ...] = ()
    strengths: Array = field(default_factory=lambda: STRENGTHS)

    @property
    def weights(self) -> Array:
        """Precision of all that is common, (n_common,)."""
        further = len(self.first.projections) - len(self.law.weights)
        return np.concatenate([self.law.weights, np.ones(further)])

    def both(self, strength: float) -> Quadratic:
        """Return both logs where they differ by a strength."""
        # Of an effect that several joints feel misfit would have to look alike on each.
        apart = self.second.integrated(self.law.alike.sum(axis=0) / strength + LEAST)
        return self.first.widened(len(apart.projections)) + apart

    def left(self, strength: float) -> Quadratic:
        """Return the same in candidates alone, with what is common integrated out."""
        return self.both(strength).integrated(self.weights).without(len(self.weights))

    def shortened(self) -> Iterator["Logs"]:
        """Yield both logs without each of their windows."""
        for one in self.firsts:
            yield replace(self, first=self.first - one)
        for one in self.seconds:
            yield replace(self, second=self.second - one)

    def level(self) -> float:
        """Return the log density of both logs if nothing changed, nats."""
        levels = [self.left(strength).level for strength in self.strengths]
        return float(logsumexp(levels) - np.log(len(levels)))

    def differ_beyond_misfit(self, evidence: float, needed: float) -> bool:
        """Return whether logs are likelier by so many nats if all may differ by more than all misfit exerts.

        Than with the changes of an ``evidence``, as of `OverStrengths`, nats; and, whichever window of either is left
        out, than if nothing changed.
        """

        def beyond(logs: Logs) -> float:
            return replace(logs, strengths=np.r_[STRENGTHS, BEYOND]).level()

        return beyond(self) - evidence > needed and all(
            beyond(logs) - logs.level() > needed for logs in self.shortened()
        )


class OverStrengths(Weigher):
    """Weighs sets at all strengths together.

    Parameters
    ----------
    logs : Logs
    priors : Priors
    rivals : mapping from place to places
        As `Weigher`'s.
    """

    def __init__(self, logs: Logs, priors: Priors, rivals: Mapping[int, Sequence[int]]):
        nothing = Gram(np.zeros((0, 0)), np.zeros(0), np.zeros(0))
        super().__init__(nothing, priors, rivals)
        self.logs = logs
        self._at = [self._weigher(logs, strength) for strength in logs.strengths]
        self._short: list[list[tuple[Weigher, float]]] = []
        tops = [search_sets(worth) for worth, _ in self._at]
        best = int(np.argmax([top.evidence + level for top, (_, level) in zip(tops, self._at)]))
        self.gram = self._at[best][0].gram
        for top in tops:
            search_sets(self, top.members)

    def _weigher(self, logs: Logs, strength: float) -> tuple[Weigher, float]:
        left = logs.left(strength)
        gram = Gram(left.products, left.projections, np.zeros(len(left.projections)))
        return Weigher(gram, self.priors, self.rivals, alike=True), left.level

    def _worths(self, members: Sequence[int]) -> Array:
        return np.array([worth(members).evidence + level for worth, level in self._at])

    def _weighed(self, members: tuple[int, ...]) -> Weighed:
        worths = self._worths(members)
        shares = np.exp(worths - logsumexp(worths))
        some = [worth(members) for worth, _ in self._at]
        values = shares @ [one.values for one in some]
        scatter = [np.outer(one.values - values, one.values - values) for one in some]
        covariance = np.tensordot(shares, [one.covariance + more for one, more in zip(some, scatter)], axes=1)
        return Weighed(
            members,
            values,
            float(logsumexp(worths) - np.log(len(self._at))),
            float(shares @ [one.likelihood for one in some]),
            np.linalg.inv(covariance),
        )

    def strength(self, members: Sequence[int]) -> float:
        """Return the strength at which a set is worth most."""
        return float(self.logs.strengths[np.argmax(self._worths(members))])

    def price(self, members: Sequence[int]) -> float:
        """Return by how much what a set is worth is less than what it explains, nats."""
        one = self._at[int(np.argmax(self._worths(members)))][0](members)
        return one.likelihood - one.evidence

    def losses(self, whole: Weighed) -> dict[int, float]:
        """Return what each member of a set is worth, nats, whichever window of either log is left out."""
        found = super().losses(whole)
        for at in self._shortened() if found else ():

            def worth(members: Sequence[int], at: list[tuple[Weigher, float]] = at) -> float:
                return float(logsumexp([one(members).evidence + level for one, level in at]))

            ours = worth(whole.members)
            for gone, loss in found.items():
                found[gone] = min(loss, ours - worth([one for one in whole.members if one != gone]))
        return found

    def _shortened(self) -> list[list[tuple[Weigher, float]]]:
        """Return for both logs without each of their windows what weighs sets at each strength."""
        if not self._short:
            self._short = [
                [self._weigher(logs, strength) for strength in logs.strengths]
                for logs in self.logs.shortened()
            ]
        return self._short

    def gains_of(self, differences: Array) -> Array:
        """Return what each candidate alone would be worth, nats, had the second log differed by so much more in it.

        About, and whichever window of either log is left out.

        Parameters
        ----------
        differences : ndarray of shape (..., n_candidates)
            Of each candidate, in units of its scale, where no other changes.
        """
        least = np.full(differences.shape, np.inf)
        for at in (self._at, *self._shortened()):
            none, alone = [], []
            for worth, level in at:
                h, G = worth.gram.projections, np.diag(worth.gram.products)
                # A difference moves the quadratic, and bends it no otherwise.
                none.append(level - h * differences - 0.5 * G * differences**2)
                alone.append(none[-1] + gains_alone(h + G * differences, G, self.priors))
            least = np.minimum(least, logsumexp(alone, axis=0) - logsumexp(none, axis=0))
        return least

    def best(self, needed: float) -> Weighed:
        """Return the set that is worth most, where of any two that with more names must be worth so much more, nats."""
        return max(self.seen.values(), key=lambda one: one.evidence - needed * len(one.members))

    def promises(self, now: Weighed) -> Array:
        """Return by how much each further effect would raise the log posterior odds, about; -inf of members."""
        whole = [
            level + (ours := worth(now.members)).evidence + worth.promises(ours) for worth, level in self._at
        ]
        return np.asarray(np.logaddexp.reduce(whole, axis=0) - np.log(len(self._at)) - now.evidence)
