"""Machines about which forces are taken, and what they may have more of."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from skat.effects import Effect

# Families that forces do not show.
UNSEEN = ("force_limit", "lag", "timestep", "backlash", "lag_torque", "payload")
# Factors of what motors exert, which may do nothing; and of other factors, the least.
MOTORS = ("gain", "kp")
WEAKEST = 0.2


@dataclass(frozen=True)
class Model:
    """A model about which forces are taken.

    Attributes
    ----------
    values : mapping from name of an effect to value
        In the effects' units; neutral where not given.
    late : float
        Rows by which commands reach it late.
    """

    values: Mapping[str, float]
    late: float = 0.0


@dataclass(frozen=True)
class Candidate:
    """A difference that is searched for: an effect, a weight at a place, or commands that come later.

    Attributes
    ----------
    effect : Effect
    odds : float
        Of all that act as this one.
    beside : mapping from name to value
        Where a weight is, m.
    late : float
        Rows by which commands come later; 0 of all others.
    """

    effect: Effect
    odds: float
    beside: Mapping[str, float]
    late: float = 0.0

    @property
    def is_factor(self) -> bool:
        """Whether values are told as multiples."""
        return self.effect.neutral == 1

    def told(self, value: float) -> float:
        """Return a difference, in the effect's unit, as it is told: of a factor, how many times what it was."""
        return value + self.is_factor

    def moved(self, model: Model, value: float, dt: float) -> Model | None:
        """Return a model that has so much more of it, in the effect's unit; None if there is none. ``dt`` is in s."""
        if self.late:
            return replace(model, late=model.late + value / dt)
        name = self.effect.name
        new = model.values.get(name, self.effect.neutral) + value
        low, high = self.effect.bounds
        return (
            replace(model, values={**model.values, **self.beside, name: new}) if low <= new <= high else None
        )
