"""Sets of causes with their probabilities, and the law of their values, to draw from."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from sklearn.utils import check_random_state

from skat.diagnosis.chains import Array
from skat.diagnosis.evidence import weigh
from skat.diagnosis.fitting import value_at
from skat.diagnosis.found import Found
from skat.effects import Effect
from skat.files import whole, writable

# Sets that are less likely than this are left out.
LEAST_PROBABILITY = 1e-3


@dataclass(frozen=True)
class CauseSet:
    """A set of causes, and the normal law of their values in the coordinates of the search.

    Attributes
    ----------
    names : tuple of str
    probability : float
    values : dict of str to float
        The likeliest.
    mean : ndarray of shape (n_causes,)
        From neutral, factors on the logarithm.
    covariance : ndarray of shape (n_causes, n_causes)
    """

    names: tuple[str, ...]
    probability: float
    values: dict[str, float]
    mean: Array
    covariance: Array


@dataclass(frozen=True)
class Posterior:
    """What may be behind a log.

    Attributes
    ----------
    sets : tuple of CauseSet
        The likeliest first; probabilities sum to 1.
    effects : tuple of Effect
    """

    sets: tuple[CauseSet, ...]
    effects: tuple[Effect, ...]

    @classmethod
    def of(cls, found: Found) -> "Posterior":
        """Return the posterior of a search."""
        shares = {
            one.members: float(share) for one, share in zip(found.ranked.sets, found.ranked.probabilities)
        }
        likely = sorted(shares, key=lambda members: -shares[members])
        kept = max(1, sum(shares[members] >= LEAST_PROBABILITY for members in likely))
        total = sum(shares[members] for members in likely[:kept])
        values = {one.members: one.values for one in found.ranked.sets}
        sets = []
        for members in likely[:kept]:
            weighed = weigh(found.gram, found.priors, members)
            mean = values.get(members, weighed.values)
            names = tuple(found.priors.names[member] for member in members)
            places = [value_at(found.effects[member], at) for member, at in zip(members, mean)]
            sets.append(
                CauseSet(
                    names,
                    shares[members] / total,
                    dict(zip(names, places)),
                    mean,
                    weighed.covariance,
                )
            )
        return cls(tuple(sets), found.effects)

    def sample(
        self, n: int, random_state: int | np.random.RandomState | None = None
    ) -> list[dict[str, float]]:
        """Return draws of causes with values within bounds: what ``simulator.extended`` takes.

        Parameters
        ----------
        n : int
        random_state : int, RandomState or None
        """
        random = check_random_state(random_state)
        known = {effect.name: effect for effect in self.effects}
        chosen = random.choice(len(self.sets), size=n, p=[one.probability for one in self.sets])
        draws = []
        for index in chosen:
            one = self.sets[index]
            places = random.multivariate_normal(one.mean, one.covariance) if one.names else ()
            draws.append({name: value_at(known[name], float(at)) for name, at in zip(one.names, places)})
        return draws

    def to_randomization(
        self, path: str | Path, *, n: int = 100, random_state: int | None = None, force: bool = False
    ) -> Path:
        """Write draws as JSON, for domain randomisation.

        Parameters
        ----------
        path : str or Path
        n : int, default=100
        random_state : int, optional
        force : bool, default=False
            Whether a file that exists may be overwritten.

        Returns
        -------
        Path
        """
        target = writable(path, force=force)
        content = {"schema": 1, "draws": self.sample(n, random_state)}
        with whole(target) as draft:
            draft.write_text(json.dumps(content, indent=1) + "\n")
        return target
