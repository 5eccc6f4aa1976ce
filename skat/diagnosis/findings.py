"""What a diagnosis finds, as data: causes and gains."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Alias:
    """An effect that may stand in the place of a cause.

    Attributes
    ----------
    name : str
    probability : float
        That it does.
    """

    name: str
    probability: float

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Cause:
    """A physical quantity that the simulation has wrong.

    Attributes
    ----------
    name, family, target : str
        ``"damping[leg_joint]"`` is of the family ``"damping"`` and has the target ``"leg_joint"``.
    value : float
        Estimate, in `unit`.
    interval : tuple of two floats
        95 % interval.
    unit : str
    probability : float
        That it is a cause, of all sets of causes that were weighed; with long logs a lower bound.
    evidence : float
        Log odds for the set of causes with it against that without, nats.
    aliases : tuple of Alias
        Effects that may be behind it instead: these data cannot tell them from this one.
    sentence : str
    at_bound : bool
        Whether the estimate is at an end of the effect's bounds, so that something else may be behind it.
    """

    name: str
    family: str
    target: str | None
    value: float
    interval: tuple[float, float]
    unit: str
    probability: float
    evidence: float
    aliases: tuple[Alias, ...]
    sentence: str
    at_bound: bool = False


@dataclass(frozen=True)
class Gain:
    """How much better the extended simulation is on data that it was not fitted to.

    Attributes
    ----------
    nominal, extended : float
        Error of the simulation as given, and with the causes built in. At a horizon: mean squared error in units of
        what a right model has. Whole episodes: root mean squared distance, in the outputs' units.
    floor : float
        What a right model would have: 1 at a horizon. Over whole episodes from measured initial states it is that of
        noise in what is compared: the noise of the initial states, which a right model carries on, is not in it.
    explained : float
        (nominal - extended) / (nominal - floor); 0 where the simulation as given is at the floor.
    interval : tuple of two floats
        95 % interval of `explained`, from a bootstrap over blocks of time, or over whole episodes; without end
        where there may be no excess at all, NaN where there are fewer than five.
    horizon : float or str
        In s (rows where the simulation has no time), or "episode".
    channels : dict of str to tuple of two floats
        (nominal, extended) root mean squared error of each output, in its unit, none of which counts for more than ten
        standard deviations of what was measured, in this log or in the one that was fitted.
    """

    nominal: float
    extended: float
    floor: float
    explained: float
    interval: tuple[float, float]
    horizon: float | str = 1.0
    channels: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def ratio(self) -> float:
        """How many times smaller the extended simulation's error is."""
        return self.nominal / self.extended if self.extended > 0 else float("inf")
