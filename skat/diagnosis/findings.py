"""What a diagnosis finds, as data: causes and gains."""

from dataclasses import dataclass, field


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
        95 % confidence interval.
    unit : str
    p_value : float
        Chance of naming any effect so clearly where nothing is wrong.
    aliases : tuple of str
        Effects that would explain the log as well: these data cannot tell them from this one.
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
    p_value: float
    aliases: tuple[str, ...]
    sentence: str
    at_bound: bool = False


@dataclass(frozen=True)
class Gain:
    """How much better the extended simulation is on data that it was not fitted to.

    Attributes
    ----------
    nominal, extended : float
        Error of the simulation as given, and with the causes built in. One step: mean squared error in units of what
        noise alone gives. Whole episodes: root mean squared distance, in the outputs' units.
    floor : float
        What a right model would have: 1 one step ahead. Over whole episodes from measured initial states it is that of
        noise in what is compared: the noise of the initial states, which a right model carries on, is not in it.
    explained : float
        (nominal - extended) / (nominal - floor); 0 where the simulation as given is at the floor.
    interval : tuple of two floats
        95 % interval of `explained`, from a bootstrap over blocks of time, or over whole episodes; without end where
        there may be no excess at all, NaN where there are fewer than five.
    horizon : int or str
        1, or "episode".
    channels : dict of str to tuple of two floats
        (nominal, extended) root mean squared error of each output, in its unit.
    """

    nominal: float
    extended: float
    floor: float
    explained: float
    interval: tuple[float, float]
    horizon: int | str = 1
    channels: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def ratio(self):
        """How many times smaller the extended simulation's error is."""
        return self.nominal / self.extended if self.extended > 0 else float("inf")
