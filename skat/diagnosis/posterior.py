"""Sets of causes with their probabilities, and the law of their values, to draw from."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from sklearn.utils import check_random_state

from skat.diagnosis.causes import Found
from skat.diagnosis.evidence import weigh
from skat.diagnosis.filtering import Array
from skat.diagnosis.fitting import value_at
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
        shares = found.ranked.probabilities
        kept = max(1, int(np.sum(shares >= LEAST_PROBABILITY)))
        sets = []
        for share, one in zip(shares[:kept] / shares[:kept].sum(), found.ranked.sets):
            names = tuple(found.priors.names[member] for member in one.members)
            places = [value_at(found.effects[member], at) for member, at in zip(one.members, one.values)]
            curvature = weigh(found.gram, found.priors, one.members).curvature
            sets.append(
                CauseSet(
                    names,
                    float(share),
                    dict(zip(names, places)),
                    one.values,
                    np.asarray(np.linalg.inv(curvature), dtype=np.float64),
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
