"""When a log contradicts a simulator: usual mistakes in columns, and the error that each would leave if mended."""

import itertools
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skat.logs.log import Log, Match
from skat.logs.matching import Inputs, simulator_inputs
from skat.simulators import Simulator
from skat.simulators.tables import Array

# Rows that stand for the log, and how many follow each other.
ROWS, RUN = 400, 50
# Pairs and channels tried at most.
MOST_PAIRS = 120
# Complete rows, without which nothing is said.
FEWEST = 10
DEGREES = math.pi / 180
# Degrees are certain where they leave less than this share of the error, and explain half of what changes,
CERTAIN, EXPLAINED = 1 / 3, 0.5
# and where an angle reaches so many of them: a robot that moves does.
LEAST_DEGREES = 3.0
# How many times further positions move than velocities say, from half to twice of it, tells their units apart.
SAME = 3.0
# A joint's range is exceeded by so many times its width, and kept to in degrees, with this much to spare.
EXCEEDED, SPARE = 1.0, 1.2
# The size of an error is taken where this share of rows are below it: a few contacts are not the matter.
SHARE = 0.7
KINDS = ("degrees", "sign", "swap", "shift")
# Rows by which a clock may be apart from another.
LAGS = (-2, -1, 1, 2)
# By which a repair of what is exact is divided, without an overflow.
TINY = 1e-300


@dataclass(frozen=True)
class Suspect:
    """A repair of a log that was tried.

    Attributes
    ----------
    kind : str
        "degrees", "sign", "swap" or "shift".
    sentence : str
        What it would mean, such as "ctrl.a and ctrl.b are swapped".
    error : float
        One-step error of the velocities (where these would be shifted, of the positions) as the log is, as a share of
        how much they change from row to row; root mean square over channels. 1 is what a simulation leaves that says
        nothing changes.
    repaired : float
        The same with the repair.
    options : dict
        Keyword arguments of `load_log` that make the repair; empty where none does.
    """

    kind: str
    sentence: str
    error: float
    repaired: float
    options: dict[str, Any] = field(default_factory=dict)


def suspects(
    simulator: Simulator | Sequence[Simulator],
    log: Log,
    *,
    kinds: Sequence[str] | None = None,
    n_rows: int = ROWS,
) -> list[Suspect]:
    """Return the repairs that were tried, the most telling first.

    Parameters
    ----------
    simulator : Simulator or sequence of Simulator
        ``log.simulator``, or that with causes built in. Of several, that counts which leaves least: causes found in a
        log with a mistake may be the mistake's, and would stand in the way of its repair.
    log : Log
    kinds : sequence of {"degrees", "sign", "swap", "shift"}, optional
        All by default.
    n_rows : int, default=400
        Rows that are simulated for each.

    Returns
    -------
    list of Suspect
        By the share of the error that is left.
    """
    simulators = [simulator] if isinstance(simulator, Simulator) else list(simulator)
    sample = _sample(simulators[0], log, n_rows)
    if sample is None:
        return []
    before: dict[str, float] = {}
    found = []
    for repair in _repairs(sample, log):
        if repair.kind not in (kinds or KINDS):
            continue
        columns = sample.positions if repair.seen_in == "qpos" else sample.velocities
        if repair.seen_in not in before:
            before[repair.seen_in] = min(sample.error(one, columns) for one in simulators)
        error = before[repair.seen_in]
        repaired = min(sample.error(one, columns, repair.applied) for one in simulators)
        if np.isfinite(error) and np.isfinite(repaired):
            found.append(Suspect(repair.kind, repair.sentence, error, repaired, repair.options))
    return sorted(found, key=lambda suspect: suspect.repaired / max(suspect.error, TINY))


def in_degrees(simulator: Simulator, log: Log, *, told: frozenset[str] = frozenset()) -> Suspect | None:
    """Return the suspicion that angles are in degrees where that is certain: by the joints' ranges, or the error left.

    Parameters
    ----------
    simulator : Simulator
    log : Log
    told : frozenset of str
        Names whose unit is known.
    """
    inputs = simulator_inputs(simulator)
    exceeded = _beyond_ranges(log, inputs, told)
    angles = [name for name in simulator.angle_names if name.startswith("qpos.") and name not in told]
    largest = max(
        (float(np.nanmax(np.abs(_column(log, name)))) for name in angles if _measured(log, name)), default=0.0
    )
    if largest < LEAST_DEGREES:
        return None
    tried = suspects(simulator, log, kinds=("degrees",))
    best = tried[0] if tried else None
    # Noise may leave more than half of what changes from row to row to the right model, too.
    if best is not None and best.repaired < max(
        min(CERTAIN * best.error, EXPLAINED), min(DEGREES * best.error, 1.0)
    ):
        return Suspect(
            "degrees",
            f"{best.sentence}: read so, one step of the simulation misses the velocities by {best.repaired:.2g} of "
            f"their change instead of {best.error:.2g}" + (f", and {exceeded}" if exceeded else "") + ".",
            best.error,
            best.repaired,
            best.options,
        )
    if exceeded and (best is None or best.repaired < 1.5 * best.error):
        options = best.options if best is not None else {"units": "deg"}
        return Suspect("degrees", f"{exceeded}: these look like degrees.", math.nan, math.nan, options)
    return None


def _beyond_ranges(log: Log, inputs: Inputs, told: Collection[str]) -> str:
    """Return what exceeds the joints' ranges by far as it is and keeps to them in degrees; "" where nothing does."""
    beyond = []
    for name in inputs.kinds["qpos"]:
        if name not in inputs.limits or name in told or not _measured(log, name):
            continue
        if log.simulator.units.get(name) != "rad":
            continue
        low, high = inputs.limits[name]
        values = _column(log, name)
        first, last = np.nanquantile(values, [0.02, 0.98])
        width = high - low
        centre = (high + low) / 2
        if max(last - high, low - first) > EXCEEDED * width:
            if max(abs(first * DEGREES - centre), abs(last * DEGREES - centre)) > SPARE * width / 2:
                return ""
            beyond.append(
                f"{name} reaches {last if last - high > low - first else first:.3g} where the joint allows {low:.3g} "
                f"to {high:.3g} rad"
            )
    return "; ".join(beyond[:3])


def _column(log: Log, name: str) -> Array:
    return log.X[:, log.simulator.input_names.index(name)]


def _measured(log: Log, name: str) -> bool:
    return log.measured.get(name, 0.0) > 0


@dataclass(frozen=True)
class _Repair:
    """What may have gone wrong, and how it is put right.

    Attributes
    ----------
    kind, sentence, options
        See `Suspect`.
    applied : callable
        ``applied(X, y)`` changes both in place.
    seen_in : str
        "qvel" or "qpos": the channels whose error tells.
    """

    kind: str
    sentence: str
    applied: Callable[[Array, Array], None]
    options: dict[str, Any] = field(default_factory=dict)
    seen_in: str = "qvel"


@dataclass(frozen=True)
class _Sample:
    """Rows that stand for a log, complete: what was not measured is filled in.

    Attributes
    ----------
    X, y : ndarray of shape (n_rows, n_inputs), (n_rows, n_states)
    lagged : mapping from number of rows to (X, y) so many rows later
    velocities : ndarray of int
        Columns of rates that were measured, or follow from positions.
    rates, positions : ndarray of int
        Columns of rates that were measured, and of their positions.
    known : frozenset of str
        Names that are not filled in.
    """

    simulator: Simulator
    X: Array
    y: Array
    lagged: dict[int, tuple[Array, Array]]
    inputs: Inputs
    velocities: NDArray[np.intp]
    rates: NDArray[np.intp]
    positions: NDArray[np.intp]
    known: frozenset[str]

    def error(
        self,
        simulator: Simulator,
        columns: Sequence[int] | NDArray[np.intp],
        repair: Callable[[Array, Array], None] | None = None,
    ) -> float:
        """Return the error of a simulator's step in some columns, with a repair."""
        X, y = self.X.copy(), self.y.copy()
        if repair is not None:
            repair(X, y)
        predicted = simulator.predict_many(X, [{}])[0]
        n_states = y.shape[1]
        missed = np.abs(y - predicted)[:, columns]
        changed = np.abs(y - X[:, :n_states])[:, columns]
        missed = np.where(np.isfinite(missed), missed, np.inf)
        size = np.quantile(changed, SHARE, axis=0)
        moving = size > 0
        if not moving.any():
            return math.nan
        ratios = np.quantile(missed, SHARE, axis=0, method="lower")[moving] / size[moving]
        return float(np.sqrt(np.mean(np.minimum(ratios, 1e6) ** 2)))


def _sample(simulator: Simulator, log: Log, n_rows: int) -> _Sample | None:
    inputs = simulator_inputs(simulator)
    names = list(simulator.input_names)
    runs = max(1, n_rows // RUN)
    length = min(RUN, len(log))
    starts = np.unique(np.linspace(0, len(log) - length, runs).astype(int))
    places = np.unique(starts[:, None] + np.arange(length))
    X, y, groups = log.X[places].copy(), log.y[places].copy(), log.groups[places]
    follows = np.r_[False, (np.diff(places) == 1) & (np.diff(groups) == 0)]
    measured = {name for name in names if np.isfinite(X[:, names.index(name)]).any()}
    _difference(X, y, follows, names, log)
    defaults = _defaults(simulator, names)
    lacking = [names.index(name) for name in log.unmeasured if not np.isfinite(X[:, names.index(name)]).any()]
    for column in lacking:
        X[:, column] = y[:, column] = defaults[column]
    lagged = {}
    for lag in LAGS:
        moved = np.clip(places + lag, 0, len(log) - 1)
        same = (log.groups[moved] == groups)[:, None]
        lagged[lag] = tuple(np.where(same, values[moved], np.nan) for values in (log.X, log.y))
    known = frozenset(name for name in names if names.index(name) not in lacking)
    joints = [name for name in inputs.kinds["qvel"] if name in known and name not in inputs.roots]
    twins = {name: f"qpos.{name.removeprefix('qvel.')}" for name in joints}
    pairs = [(name, twin) for name, twin in twins.items() if {name, twin} <= measured]
    good = np.isfinite(X).all(axis=1) & np.isfinite(y).all(axis=1)
    for other in itertools.chain.from_iterable(lagged.values()):
        shown = [place for place, name in enumerate(names[: other.shape[1]]) if name in measured]
        good &= np.isfinite(other[:, shown]).all(axis=1)
    if good.sum() < FEWEST or not joints:
        return None

    def places_of(chosen: Sequence[str]) -> NDArray[np.intp]:
        return np.array([names.index(name) for name in chosen], dtype=int)

    return _Sample(
        simulator,
        X[good],
        y[good],
        {lag: (before[good], after[good]) for lag, (before, after) in lagged.items()},
        inputs,
        places_of(joints),
        places_of([name for name, _ in pairs]),
        places_of([twin for _, twin in pairs]),
        known,
    )


def _difference(X: Array, y: Array, follows: NDArray[np.bool_], names: Sequence[str], log: Log) -> None:
    """Put differences of positions where velocities were not measured, in place."""
    for position, name in enumerate(names):
        twin = f"qvel.{name.removeprefix('qpos.')}"
        if not name.startswith("qpos.") or twin not in names or np.isfinite(X[:, names.index(twin)]).any():
            continue
        velocity = names.index(twin)
        step = (y[:, position] - X[:, position]) / log.dt
        before = np.r_[np.nan, step[:-1]]
        before[~follows] = np.nan
        after = np.r_[step[1:], np.nan]
        after[~np.r_[follows[1:], False]] = np.nan
        X[:, velocity] = (before + step) / 2
        y[:, velocity] = (step + after) / 2


def _defaults(simulator: Simulator, names: Sequence[str]) -> Array:
    """Return a value for each input that was not measured: the model's reference pose."""
    state = simulator.reference_state
    return np.concatenate([state, np.zeros(len(names) - len(state))])


def _repairs(sample: _Sample, log: Log) -> Iterator[_Repair]:
    """Yield what may have gone wrong."""
    names = list(sample.simulator.input_names)
    inputs = sample.inputs
    theirs = {match.name: match for match in log.matches}
    yield from _degree_repairs(sample, names, inputs)
    joints = [name for name in inputs.kinds["qpos"] if name in sample.known and name not in inputs.roots]
    for name in joints:
        twin = f"qvel.{name.removeprefix('qpos.')}"
        pair = [one for one in (name, twin) if one in names]
        told = [one for one in pair if one in theirs]
        yield _Repair(
            "sign",
            f"{' and '.join(told or pair)} {'have' if len(told or pair) > 1 else 'has'} the opposite sign",
            _scaler([names.index(one) for one in pair], -1.0),
            _sign_options(told, theirs, sample.simulator),
        )
    for name in [one for one in (*inputs.kinds["qvel"], *inputs.kinds["ctrl"]) if one in theirs]:
        yield _Repair(
            "sign",
            f"{name} has the opposite sign",
            _scaler([names.index(name)], -1.0),
            _sign_options([name], theirs, sample.simulator),
        )
    for members in (list(inputs.kinds["ctrl"]), joints):
        for first, second in itertools.islice(itertools.combinations(members, 2), MOST_PAIRS):
            yield _swap(first, second, names, theirs)
    yield from _shifts(sample)


def _shifts(sample: _Sample) -> Iterator[_Repair]:
    """Yield the repairs of clocks that are apart: of commands, and of velocities from positions."""
    n_states = sample.y.shape[1]
    commands = list(range(n_states, sample.X.shape[1]))
    for lag in sample.lagged:
        rows = f"{abs(lag)} row{'s' if abs(lag) > 1 else ''} {'earlier' if lag < 0 else 'later'}"
        if commands:
            yield _Repair(
                "shift",
                f"the commands fit those of {rows}: the clocks of commands and state are apart, or there is a delay",
                _replacer(commands, sample.lagged[lag]),
            )
        if len(sample.rates):
            yield _Repair(
                "shift",
                f"the velocities fit those of {rows}: the clocks of velocities and positions are apart, or a filter "
                "delays one of them",
                _replacer(sample.rates, sample.lagged[lag]),
                seen_in="qpos",
            )


def _degree_repairs(sample: _Sample, names: Sequence[str], inputs: Inputs) -> Iterator[_Repair]:
    angles = [name for name in sample.simulator.angle_names if name in sample.known]
    positions = [name for name in angles if name.startswith("qpos.")]
    velocities = [name for name in angles if names.index(name) in sample.rates]
    servos = [name for name in inputs.servos if inputs.units.get(name) == "rad"]
    rates = [name for name in inputs.servos if inputs.units.get(name) == "rad/s"]
    if not positions:
        return
    differenced = {f"qvel.{name.removeprefix('qpos.')}" for name in positions} - set(velocities)
    choices = [
        (
            "the angles, their rates and the commands of servos look like degrees",
            [*positions, *velocities, *servos, *rates],
            "deg",
        ),
        ("the angles look like degrees, their rates like rad/s", positions, {"qpos.*": "deg"}),
        (
            "the angles and their rates look like degrees, commands like rad",
            [*positions, *velocities],
            {"qpos.*": "deg", "qvel.*": "deg"},
        ),
        (
            "the angles and the commands of servos look like degrees, the rates like rad/s",
            [*positions, *servos],
            {"qpos.*": "deg", "ctrl.*": "deg"},
        ),
    ]
    seen = set()
    ratio = _moved_by_told(sample, names, positions)
    for sentence, scaled, units in choices:
        alone = not set(scaled) & set(velocities)
        if ratio is not None and velocities and not 1 / SAME < ratio * (DEGREES if alone else 1.0) < SAME:
            continue
        columns = [names.index(name) for name in (*scaled, *differenced) if name in names]
        if tuple(columns) not in seen and scaled:
            seen.add(tuple(columns))
            yield _Repair("degrees", sentence, _scaler(columns, DEGREES), {"units": units})


def _moved_by_told(sample: _Sample, names: Sequence[str], positions: Sequence[str]) -> float | None:
    """Return how many times further positions move than measured velocities say; None where neither moves."""
    pairs = [(q, v) for v, q in zip(sample.rates, sample.positions) if names[q] in positions]
    moved = np.array([np.median(np.abs(sample.y[:, q] - sample.X[:, q])) for q, _ in pairs])
    told = (
        np.array([np.median(np.abs(sample.X[:, v] + sample.y[:, v])) / 2 for _, v in pairs])
        * sample.simulator.dt
    )
    good = (moved > 0) & (told > 0)
    return float(np.median(moved[good] / told[good])) if good.any() else None


def _scaler(columns: Sequence[int] | NDArray[np.intp], factor: float) -> Callable[[Array, Array], None]:
    def repair(X: Array, y: Array) -> None:
        X[:, columns] *= factor
        states = [column for column in columns if column < y.shape[1]]
        y[:, states] *= factor

    return repair


def _replacer(
    columns: Sequence[int] | NDArray[np.intp], other: tuple[Array, Array]
) -> Callable[[Array, Array], None]:
    """Return the repair that takes columns from other rows."""
    before, after = other
    states = [column for column in columns if column < after.shape[1]]

    def repair(X: Array, y: Array) -> None:
        X[:, columns] = before[:, columns]
        y[:, states] = after[:, states]

    return repair


def _swap(first: str, second: str, names: Sequence[str], theirs: Mapping[str, Match]) -> _Repair:
    pairs = [(first, second)]
    if first.startswith("qpos."):
        pairs.append((f"qvel.{first.removeprefix('qpos.')}", f"qvel.{second.removeprefix('qpos.')}"))
    pairs = [(a, b) for a, b in pairs if a in names and b in names]

    def repair(X: Array, y: Array) -> None:
        for a, b in pairs:
            i, j = names.index(a), names.index(b)
            X[:, [i, j]] = X[:, [j, i]]
            if max(i, j) < y.shape[1]:
                y[:, [i, j]] = y[:, [j, i]]

    options: dict[str, str] = {}
    for a, b in pairs:
        if a in theirs and b in theirs:
            options |= {a: _with_unit(theirs[b]), b: _with_unit(theirs[a])}
    return _Repair(
        "swap", f"{first} and {second} are swapped", repair, {"columns": options} if options else {}
    )


def _with_unit(match: Match) -> str:
    return f"{match.theirs}:{match.unit}" if match.unit else match.theirs


def _sign_options(told: Collection[str], theirs: Mapping[str, Match], simulator: Simulator) -> dict[str, Any]:
    columns = {}
    for name in told:
        unit = theirs[name].unit or simulator.units.get(name, "") or "x:1"
        if unit.startswith("-") or "+" in unit or "-" in unit[1:]:
            return {}
        columns[name] = f"{theirs[name].theirs}:-{unit}"
    return {"columns": columns} if columns else {}
