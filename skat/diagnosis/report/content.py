"""All that a report shows, as frozen data: who fills it computes, and the page is a view that computes nothing.

What is not known is None, or an empty tuple, and is left out of the page. Names of channels, joints and effects are
those of the simulator. Where the diagnosis named nothing, `extended` is None wherever it stands beside `nominal`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

VERDICTS = ("nothing detected", "named", "ambiguous", "unexplained")


# -- what is said first --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Alternative:
    """Another name, or set of names, that explains the log nearly as well.

    `probability`: None where the engine gives none.
    """

    names: tuple[str, ...]
    probability: float | None = None


@dataclass(frozen=True)
class Verdict:
    """The answer in one line, and what has to be said beside it.

    `name` in {"nothing detected", "named", "ambiguous", "unexplained"}. `headline`: such as "1 cause named".
    `probability`: of the set of causes named; None where the engine gives none. `alternatives`: other sets, most
    probable first.
    """

    name: str
    headline: str
    sentences: tuple[str, ...] = ()
    probability: float | None = None
    alternatives: tuple[Alternative, ...] = ()


@dataclass(frozen=True)
class ShownCause:
    """A cause with all that is known of it.

    `interval`: 95 %. `neutral`: at which it does nothing. `evidence`: in the engine's own terms, such as "p = 0.002" or
    "34 nats". `at_bound`: whether the estimate stands at an end of the range allowed.
    """

    name: str
    unit: str
    value: float
    interval: tuple[float, float]
    neutral: float
    sentence: str
    probability: float | None = None
    evidence: str = ""
    aliases: tuple[Alternative, ...] = ()
    at_bound: bool = False


# -- measured against simulated ------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Series:
    """A channel over time: measured, and simulated before and after.

    `measured`, `nominal` (n_times,): NaN where there is none: lines break there. `extended` (n_times,).
    """

    name: str
    unit: str
    measured: Array
    nominal: Array
    extended: Array | None = None


@dataclass(frozen=True, eq=False)
class Episode:
    """Channels of an episode, those with the largest error first.

    `label`: such as "episode 3, the worst". `time` (n_times,). `time_label`: with its unit: "time (s)", or "step".
    """

    label: str
    time: Array
    channels: tuple[Series, ...]
    time_label: str = "time (s)"


@dataclass(frozen=True, eq=False)
class Cloud:
    """A channel of rows that do not follow each other: measured against simulated.

    `measured`, `nominal` (n_rows,). `extended` (n_rows,).
    """

    name: str
    unit: str
    measured: Array
    nominal: Array
    extended: Array | None = None


@dataclass(frozen=True)
class ChannelError:
    """Root mean squared error of a channel, in its unit.

    `floor`: what noise alone gives. `gain`: share of the excess over the floor that is gone. `interval`: 95 %, of
    `gain`.
    """

    name: str
    unit: str
    nominal: float
    extended: float | None = None
    floor: float | None = None
    gain: float | None = None
    interval: tuple[float, float] | None = None


@dataclass(frozen=True)
class MethodError:
    """Error of a simulation, or of a map from it to the data.

    `error`: in standard deviations of each output; None where the method has no answer. `kind` in {"before", "after",
    "map"}. `ratio`: to the extended simulation's. `interval`: 95 %, of `ratio`. `n_rows`: that it was fitted to.
    """

    method: str
    error: float | None
    kind: str = "map"
    ratio: float | None = None
    interval: tuple[float, float] | None = None
    n_rows: int = 0


@dataclass(frozen=True, eq=False)
class ShownLog:
    """Data with which the simulations are compared: best those that nothing was fitted to.

    `title`: such as "Rows held out". `is_fitted`: whether the causes were fitted to these very rows, so that no gain is
    measured. `horizon`: in words, how far ahead `errors` predict: "0.4 s ahead", "one step ahead", "whole episodes".
    `signal_horizon`: the same of `episodes`. `sentences`: what the gain is. `episodes`: the worst first. `clouds`: in
    their place where rows do not follow each other. `comparison_sentences`: what the comparison says, with its notes.
    """

    title: str
    is_fitted: bool = False
    horizon: str = ""
    signal_horizon: str = ""
    sentences: tuple[str, ...] = ()
    episodes: tuple[Episode, ...] = ()
    clouds: tuple[Cloud, ...] = ()
    errors: tuple[ChannelError, ...] = ()
    comparison: tuple[MethodError, ...] = ()
    comparison_sentences: tuple[str, ...] = ()


# -- what is left, and what could be seen --------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Law:
    """How a mean depends on a regressor, in bins.

    `x`, `mean`, `low`, `high` (n_bins,): centre of each bin, the mean and its 95 % interval. `before` (n_bins,): the
    mean that the simulation as given leaves, for comparison.
    """

    regressor: str
    unit: str
    x: Array
    mean: Array
    low: Array
    high: Array
    before: Array | None = None


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Power density of what is left.

    `frequency` (n_frequencies,): in Hz. `density` (n_frequencies,): in squared units per Hz. `word`: "white", "drift",
    "vibration at 22 Hz", "impacts".
    """

    frequency: Array
    density: Array
    word: str = ""


@dataclass(frozen=True, eq=False)
class Left:
    """What no cause explains, at one joint or channel.

    `name`: of the joint, or of the channel. `unit`: "N m", "N", or the channel's own. `rms`: root mean square.
    `interval`: 95 %; where it is wide, the page gives a bound in the place of a number. `scale`: what `rms` is to be
    held against: the root mean square of what the actuators do there. `predictable`: share of its variance that the
    regressor of `law` predicts, on rows not used to find it.
    """

    name: str
    unit: str
    rms: float | None = None
    interval: tuple[float, float] | None = None
    scale: float | None = None
    predictable: float | None = None
    law: Law | None = None
    spectrum: Spectrum | None = None
    sentence: str = ""


@dataclass(frozen=True)
class ChannelNoise:
    """Noise of a measured channel.

    `deviation`: standard deviation. `interval`: 95 %. `tail`: degrees of freedom of Student's law; infinite where it is
    normal.
    """

    name: str
    unit: str
    deviation: float
    interval: tuple[float, float] | None = None
    tail: float | None = None


@dataclass(frozen=True)
class ForceNoise:
    """A random force on a joint.

    `memory_s`: time constant; 0 where it is white. `returns`: whether it is taken back within that time, as a
    vibration's; otherwise it lasts that long. `beside`: the joint whose random force goes most with it; empty where
    there is no other. `correlation`: of both, from -1 to 1: a base that shakes or a link that bends pushes several
    joints at once.
    """

    name: str
    unit: str
    rms: float
    memory_s: float | None = None
    returns: bool = False
    beside: str = ""
    correlation: float = 0.0


@dataclass(frozen=True)
class Visibility:
    """How small an effect these data would have shown.

    `smallest`: away from neutral, named one time in two; infinite where these data say nothing of it. `similarity`: to
    that, from 0 to 1: at 1 the two cannot be told apart. `excitation`: what to measure so that the two could be told
    apart.
    """

    name: str
    unit: str
    smallest: float
    nearest_alias: str = ""
    similarity: float | None = None
    is_named: bool = False
    excitation: str = ""


# -- what to do about it, and how it was found ---------------------------------------------------------------


@dataclass(frozen=True)
class Change:
    """An attribute of an element of the model, before and after.

    `element`: such as ``joint "elbow"``. `attribute`: empty where the element as a whole came or went. `before`,
    `after`: None where it was not there.
    """

    element: str
    attribute: str
    before: str | None
    after: str | None


@dataclass(frozen=True)
class Still:
    """A picture of the robot."""

    title: str
    alt: str
    png: bytes


@dataclass(frozen=True)
class SourceFile:
    """A file that the findings come from.

    `role`: "model", "log", "test". `path`: as the user gave it. `sha256`: empty where it is a folder or is gone.
    `size`: in bytes.
    """

    role: str
    path: str
    sha256: str = ""
    size: int | None = None


@dataclass(frozen=True)
class Provenance:
    """How the findings were made.

    `date`: ISO 8601, with the offset from UTC. `command`: empty where it was no command. `versions`: names of packages
    with their versions. `warnings`, `notes`: all that was said while the log was read and the diagnosis ran.
    """

    date: str = ""
    files: tuple[SourceFile, ...] = ()
    command: str = ""
    versions: tuple[tuple[str, str], ...] = ()
    seed: str = ""
    settings: tuple[tuple[str, str], ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Table:
    """A table of the user's own: texts, ready to be shown.

    `numeric`: which columns hold numbers.
    """

    title: str
    columns: list[str]
    rows: list[list[str]]
    numeric: list[bool]


@dataclass(frozen=True, eq=False)
class Content:
    """All that a page shows.

    Attributes
    ----------
    title : str
        What it is of, such as "arm.xml against monday.csv".
    verdict : Verdict
    causes : tuple of ShownCause
        Most telling first.
    also_seen : tuple of ShownCause
        True, but too small to matter.
    logs : tuple of ShownLog
    left : tuple of Left
        The largest first.
    left_sentences : tuple of str
    noise : tuple of ChannelNoise
    forces : tuple of ForceNoise
    visibility : tuple of Visibility
    next_steps : tuple of str
        What to measure next, most useful first.
    changes : tuple of Change
    beside : tuple of str
        What the model's format cannot express of the causes, in words.
    stills : tuple of Still
    stills_note : str
        Why there are none.
    tables : tuple of Table
    provenance : Provenance
    """

    title: str
    verdict: Verdict
    causes: tuple[ShownCause, ...] = ()
    also_seen: tuple[ShownCause, ...] = ()
    logs: tuple[ShownLog, ...] = ()
    left: tuple[Left, ...] = ()
    left_sentences: tuple[str, ...] = ()
    noise: tuple[ChannelNoise, ...] = ()
    forces: tuple[ForceNoise, ...] = ()
    visibility: tuple[Visibility, ...] = ()
    next_steps: tuple[str, ...] = ()
    changes: tuple[Change, ...] = ()
    beside: tuple[str, ...] = ()
    stills: tuple[Still, ...] = ()
    stills_note: str = ""
    tables: tuple[Table, ...] = ()
    provenance: Provenance = field(default_factory=Provenance)

    def __post_init__(self) -> None:
        if self.verdict.name not in VERDICTS:
            raise ValueError(f"verdict must be one of {', '.join(VERDICTS)}; it is {self.verdict.name!r}.")
