r"""What changed between two logs of one machine, whatever its model gets wrong in both.

Missing forces are a regression on the force of every effect, as in `force_space`, of positions alone; measured speeds
are compared with those of the positions. Each log is cut into windows of time, each of which has effects of its own:

.. math:: z_b = N_b (\theta + \eta_b + [b \in \text{after}] (\Delta + \delta)) + e_b.

:math:`\theta` is what is wrong in both logs, all effects at once, held by their priors. No model is right, and what it
misses differs from motion to motion: :math:`\eta` is by how much, and T, of each effect, is estimated within the logs,
each with values of its own. :math:`\Delta` says that logs that move otherwise differ though nothing changed: as windows
do, and by what no effect explains, which may look like any. All three are integrated out, and sparse :math:`\delta`, by
how much the logs differ more than that, are searched for by evidence. The theory page derives it.

Of a model that is not right a long log is sure of whichever set fits best, though its windows may not agree. So sets
have the mean of the probabilities that pairs of logs of windows drawn from both give them: a bagged posterior [1]_.

References
----------
.. [1] Huggins, Miller (2019). Robust inference and model criticism using bagged posteriors. arXiv:1912.07104.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from skat.diagnosis.evidence import Gram, Priors, Weighed
from skat.diagnosis.filtering import Array, Mask
from skat.diagnosis.findings import Alias, Cause, Gain
from skat.diagnosis.force_space import (
    ALIAS_ODDS,
    ROWS_FOR_ANCHORS,
    WEAKEST,
    WIDTH_95,
    Motion,
    Rows,
    noise_of,
    rivals_of,
    smooth_motion,
    smooth_squares,
    transformed,
)
from skat.diagnosis.set_search import Weigher, alternatives, search_sets, without_weak
from skat.effects import Effect
from skat.simulators import MujocoSimulator, Simulator

Log = tuple[Array, Array, NDArray[Any]]
# A log has so many windows, of so many seconds at most.
WINDOWS, LONGEST = 8, 2.0
# Effects differ between windows by this share of their typical size, told as by so many windows.
APART_AT_LEAST, PSEUDO = 0.1, 1.0
# Two logs that move otherwise differ by the variance of two windows, and of what is left of a joint's force.
APART = 2.0
# Places along each side of a body at which a weight is tried; those that act alike are one.
PLACES, ALIKE = 3, 0.9995
# Rows by which commands may come late in the first log, and by how many later, or earlier, in the second.
LATE_IN_BOTH = tuple(0.5 * one for one in range(17))
LATER = (0.5, 1.0, 2.0, 3.0, 4.0)
# Turns of noise, and within each of what windows differ by.
NOISE_TURNS, WINDOW_TURNS = 4, 5
# Of its typical size, by which an effect differs from window to window until the logs tell; and a slope is taken over.
BEGUN, STEP = 0.3, 0.01
# Families that a machine does not change from one log to another, and those that forces do not show.
FIXED = ("gravity", "tilt", "length", "wind", "air_drag", "position_friction", "inertia")
UNSEEN = ("force_limit", "lag", "timestep", "backlash", "lag_torque", "payload")
# Factors that all of a joint's force is divided by, in units of what its motor exerts.
MOTORS = ("gain", "kp")
# Odds that two columns of a log were mixed up, or that one has its sign turned.
MIXED_UP = 1e-3
BOOTSTRAPS = 400
# Pairs of logs of drawn windows, and sets of the search of both logs that each is asked for.
BAGS, POOL = 50, 32
# Log odds of what is not named, and the share of its range from neutral that a value keeps to.
NEVER, INSIDE = -1e6, 1 - 1e-6


@dataclass(frozen=True)
class Changes:
    """What changed between two logs.

    Attributes
    ----------
    changes : tuple of Cause
        Most telling first. The value is by how much an effect is more in the second log; of factors, how many times
        what it was.
    verdict : {"nothing changed", "named", "ambiguous", "unexplained"}
    gain : Gain or None
        Of windows of the second log that were held out: mean squared missing force over its noise, with what is
        common in the model, and with the changes, too; the channels are rms forces, N or N m.
    common : dict of str to tuple of two floats
        Of each degree of freedom, by the name of its speed: rms force that the model as it is lacks in the two logs,
        and what is left with all that is common in it, N or N m.
    mistake : str
        How columns of the second log seem to be mixed up; empty if they do not.
    """

    changes: tuple[Cause, ...]
    verdict: str
    gain: Gain | None
    common: dict[str, tuple[float, float]]
    mistake: str = ""


@dataclass(frozen=True)
class _Model:
    """Effect values of a model, and by how many rows commands reach it late."""

    values: Mapping[str, float]
    late: float = 0.0


@dataclass(frozen=True)
class _Candidate:
    """A difference that is searched for: an effect, a weight at a place, or commands that come later.

    Attributes
    ----------
    effect : Effect
    odds : float
        Of all that act as this one.
    beside : mapping from name to value
        Where a weight is.
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
        """Return a difference as it is told."""
        if self.effect.family in MOTORS or self.effect.name.startswith("scale[qpos."):
            share = 1 - value
            return 1 / (share if abs(share) > 1e-3 else 1e-3)
        return value + self.is_factor

    def moved(self, model: _Model, value: float, dt: float) -> _Model | None:
        """Return a model that has so much more of it; None if there is none."""
        if self.late:
            return replace(model, late=model.late + value / dt)
        name = self.effect.name
        new = model.values.get(name, self.effect.neutral) + value
        low, high = self.effect.bounds
        return (
            replace(model, values={**model.values, **self.beside, name: new}) if low <= new <= high else None
        )


@dataclass(frozen=True)
class _Half:
    """One of the logs: its motion, from positions alone, and speeds as measured, (n_blocks, nv), NaN where not."""

    motion: Motion
    speeds: Array


@dataclass(frozen=True)
class _Windows:
    """Of each window N'N (n_windows, k, k) and N'z (n_windows, k), of whitened rows."""

    products: Array
    projections: Array

    @classmethod
    def of(cls, rows: Rows, noise: Array) -> "_Windows":
        z, N = rows.whitened(noise)
        own = [rows.stretch == one for one in np.unique(rows.stretch)]
        return cls(np.stack([N[one].T @ N[one] for one in own]), np.stack([N[one].T @ z[one] for one in own]))

    def without(self, spread: Array) -> "_Windows":
        """Return these with each window's own effects integrated out.

        ``spread`` holds the variances of the first effects, of which each window has its own.
        """
        which = np.arange(len(spread))
        found = [_integrated(G, h, which, 1 / spread) for G, h in zip(self.products, self.projections)]
        return _Windows(np.stack([G for G, _ in found]), np.stack([h for _, h in found]))

    def drawn(self, times: Array) -> tuple[Array, Array]:
        """Return the sums of products and projections, each window so many times."""
        return np.tensordot(times, self.products, 1), times @ self.projections

    def every(self) -> tuple[Array, Array]:
        """Return the sums of products and projections."""
        return self.drawn(np.ones(len(self.products)))


class _Bagged(Weigher):
    """Weighs sets by the mean of their probabilities over logs of drawn windows.

    Parameters
    ----------
    whole : Weigher
        Of both logs as they are.
    bags : sequence of Weigher
        Of drawn windows.
    pool : sequence of tuple of int
        The sets that probabilities are shared out between.
    """

    def __init__(self, whole: Weigher, bags: Sequence[Weigher], pool: Sequence[tuple[int, ...]]):
        super().__init__(whole.gram, whole.priors, rivals=whole.rivals)
        self.whole, self.bags = whole, bags
        self.totals = [float(logsumexp([worth(members).evidence for members in pool])) for worth in bags]

    def _weighed(self, members: tuple[int, ...]) -> Weighed:
        ours, theirs = self.whole(members), [worth(members) for worth in self.bags]
        shares = [one.evidence - total for one, total in zip(theirs, self.totals)]
        curvature = ours.curvature
        if members:
            off = np.array([one.values for one in theirs]) - ours.values
            curvature = np.asarray(np.linalg.inv(np.linalg.inv(curvature) + off.T @ off / len(off)))
        return replace(ours, evidence=float(logsumexp(shares) - np.log(len(shares))), curvature=curvature)


def _integrated(
    products: Array, projections: Array, which: NDArray[np.intp], weights: Array
) -> tuple[Array, Array]:
    """Return products and projections of all columns, with those of a normal law of given weights integrated out."""
    held = products[np.ix_(which, which)] + np.diag(weights)
    unit = 1 / np.sqrt(np.diag(held))
    cross = products[:, which] * unit
    right = np.column_stack([cross.T, unit * projections[which]])
    solved = np.linalg.solve(held * unit * unit[:, None], right)
    return products - cross @ solved[:, :-1], projections - cross @ solved[:, -1]


def find_changes(
    simulator: Simulator,
    before: Log,
    after: Log,
    effects: Sequence[Effect],
    *,
    typical: Mapping[str, float] | None = None,
    alpha: float = 0.01,
    test_size: float = 0.3,
) -> Changes:
    """Return in what two logs of one machine differ.

    Parameters
    ----------
    simulator : Simulator
    before, after : tuple of (X, y, groups)
        Rows of an episode follow each other. NaN in states where nothing was measured.
    effects : sequence of Effect
        That may be wrong in the model or may have changed; weights on bodies are tried beside them.
    typical : mapping from name to size, optional
        Scales of the priors of a user's own.
    alpha : float, default=0.01
        A change is named if the odds for the set with it are 1 / alpha times those of the set without.
    test_size : float, default=0.3
        Share of the second log that measures the gain.

    Returns
    -------
    Changes

    Raises
    ------
    ValueError
        If the simulator is not one of joints, a joint was not measured, or contacts push all the time.
    """
    if not isinstance(simulator, MujocoSimulator):
        raise ValueError(
            "changes are searched for in the forces on joints, of which a function knows nothing: the simulator must "
            f"be a MujocoSimulator; it is {simulator!r}. Instead, fit the log before, and diagnose the log after with "
            "extended_simulator_."
        )
    halves = [_half(simulator, log, name) for name, log in (("before", before), ("after", after))]
    question = _asked(simulator, halves, effects, typical or {}, test_size)
    priors, needed = _laws(question), -np.log(alpha)
    sides = _integrated_sides(question)
    gram, common = _differences(question, sides)
    drawn = _drawn(sides)
    while True:
        worth = _bagged(question, sides, drawn, gram, priors)
        # Of any two sets, that with more names must be worth what they need.
        best = max(worth.seen.values(), key=lambda one: one.evidence - needed * len(one.members))
        best, nats = without_weak(best, worth, needed)
        absurd = _at_bounds(best, question.candidates, priors)
        if not absurd:
            break
        log_odds = priors.log_odds.copy()
        log_odds[absurd] = NEVER
        priors = replace(priors, log_odds=log_odds)
    differences = np.zeros(len(question.candidates))
    differences[list(best.members)] = best.values
    ours = worth.whole(best.members)
    mistake = _mistake(question, differences, ours.likelihood - ours.evidence, common, drawn, needed)
    if mistake:
        return Changes((), "unexplained", None, _sizes(question, common.level), mistake)
    causes = _causes(question, best, worth, nats)
    verdict = "nothing changed" if not causes else "named"
    if any(cause.aliases for cause in causes):
        verdict = "ambiguous"
    value = common.level - common.slopes @ differences
    gain = _gain(question, value, differences)
    return Changes(causes, verdict, gain, _sizes(question, value))


def _half(simulator: MujocoSimulator, log: Log, name: str) -> _Half:
    X, y, groups = (np.asarray(one) for one in log)
    n_states, nv = len(simulator.state_names), len(simulator.residual_names) // 2
    if n_states != 2 * nv:
        raise ValueError(
            "changes are searched for in the forces on joints that turn or slide, and this model has a free or a ball "
            "joint, on which contacts push. If its base did not move, pass base='fixed'; else fit the log before, and "
            "diagnose the log after with extended_simulator_."
        )
    speeds = X[:, nv:n_states], y[:, nv:]
    X, y = X.astype(float), y.astype(float)
    X[:, nv:n_states], y[:, nv:] = np.nan, np.nan
    window = min(LONGEST, len(X) * simulator.dt / WINDOWS)
    motion = smooth_motion(simulator, X, y, groups, window=window)
    if motion is None:
        raise ValueError(
            f"no stretch of the log {name} is free of contacts and long enough, or the position of a joint was not "
            "measured. Record the machine moving freely; or fit the log before, and diagnose the log after with "
            "extended_simulator_."
        )
    # The mean speed between the ends of a block.
    return _Half(motion, 0.5 * sum(one[motion.rows].mean(axis=1) for one in speeds))


@dataclass(frozen=True)
class _Question:
    """The regression of two logs of a machine.

    Attributes
    ----------
    simulator : MujocoSimulator
    halves : tuple of _Half
    base : _Model
        About which forces are taken.
    effects : tuple of Effect
        That may be wrong in both logs.
    candidates : tuple of _Candidate
        That may have changed.
    sizes, scales : ndarray
        Typical sizes of effects and of candidates: units of the columns.
    sides : tuple of Rows
        Columns are those of effects; in the second log, then those of candidates.
    law : _Law
    held_out : ndarray of bool
        Which rows of the second log measure the gain.
    """

    simulator: MujocoSimulator
    halves: tuple[_Half, ...]
    base: _Model
    effects: tuple[Effect, ...]
    candidates: tuple[_Candidate, ...]
    sizes: Array
    scales: Array
    sides: tuple[Rows, Rows]
    law: "_Law"
    held_out: Mask


def _part(rows: Rows, kept: Mask) -> Rows:
    return Rows(
        rows.target[kept],
        rows.columns[kept],
        rows.joint[kept],
        rows.frequency[kept],
        rows.stretch[kept],
        rows.nominal[kept],
    )


def _asked(
    simulator: MujocoSimulator,
    halves: Sequence[_Half],
    effects: Sequence[Effect],
    typical: Mapping[str, float],
    test_size: float,
) -> _Question:
    """Return the regression about what is common of motors and delays, with its noise."""
    seen = [effect for effect in effects if effect.family not in UNSEEN]
    common = [effect for effect in seen if effect.target != "all"]
    sizes = np.array([typical.get(effect.name, effect.typical) for effect in common])
    sides = [_rows(simulator, half, _Model({}), common, sizes) for half in halves]
    shares = _shares(_joined(sides))
    shown = np.flatnonzero(shares > 1e-9)
    common, sizes, shares = [common[place] for place in shown], sizes[shown], shares[shown]
    units = np.array(
        [
            1.0 if effect.name in typical or effect.force_share is None else effect.force_share / share
            for effect, share in zip(common, shares)
        ]
    )
    sizes = sizes * units
    sides = [replace(side, columns=side.columns[:, shown] * units) for side in sides]
    late = np.array([effect.family == "delay" for effect in common])
    # What is late in the first log is told by a grid, not by a slope.
    prompt = [replace(side, columns=side.columns * ~late) for side in sides]
    base = _base(simulator, halves[0], prompt[0], _settled(prompt))
    sides = [_rows(simulator, half, base, common, sizes) for half in halves]
    law = _settled(sides)
    apart = _apart(simulator, halves, sides, law)
    # Drivers filter speeds, which takes from a fast motion more than from a slow one.
    filtered = [effect.name.startswith("scale[qvel.") for effect in common]
    law = replace(law, apart=np.where(filtered, np.maximum(apart, 1.0), apart))
    names = {effect.name for effect in common}
    offered = [
        _Candidate(effect, effect.odds, {})
        for effect in seen
        if effect.family not in (*FIXED, "delay") and (effect.name in names or effect.target == "all")
    ]
    offered += _weights(simulator)
    offered += [
        _Candidate(effect, effect.odds / (2 * len(LATER)), {}, late)
        for effect in effects
        if effect.name == "delay[action]"
        for late in (*LATER, *(-one for one in LATER))
    ]
    known = dict(zip([effect.name for effect in common], sizes))
    for effect in seen:
        if effect.target == "all" and effect.force_share is not None and effect.name not in typical:
            own = [size for one, size in zip(common, sizes) if one.family == effect.family]
            known[effect.name] = max(own, default=effect.typical)
    scales = np.array(
        [known.get(one.effect.name, typical.get(one.effect.name, one.effect.typical)) for one in offered]
    )
    columns = _columns(simulator, halves[1], base, offered, scales)
    columns = _of_motors(offered, columns, sides[1], law.value, scales)
    noise = law.noise[1]
    offered, scales, columns = _distinct(offered, scales, columns / noise[:, None], noise)
    sides[1] = replace(sides[1], columns=np.column_stack([sides[1].columns, columns]))
    return _Question(
        simulator, tuple(halves), base, tuple(common), tuple(offered), sizes, scales, (sides[0], sides[1]),
        law, _held_out(sides[1].stretch, test_size),
    )  # fmt: skip


def _held_out(stretch: NDArray[np.intp], share: float) -> Mask:
    """Return which rows are in windows that are held out: a share of them, evenly spread, not all."""
    kinds = np.unique(stretch)
    n = min(round(share * len(kinds)), len(kinds) - 2)
    places = np.linspace(0, len(kinds) - 1, max(n, 0) + 2).astype(int)[1:-1]
    return np.isin(stretch, kinds[places])


def _shares(rows: Rows) -> Array:
    """Return what a typical size of each effect exerts, over the force on the joint that feels it most."""
    joints = [rows.joint == joint for joint in np.unique(rows.joint)]
    exerted = np.array([np.sqrt(np.mean(rows.columns[own] ** 2, axis=0)) for own in joints])
    there = np.array([np.sqrt(np.mean(rows.nominal[own] ** 2)) for own in joints])
    return np.asarray(np.max(exerted / np.maximum(there, 1e-300)[:, None], axis=0))


def _weights(simulator: MujocoSimulator) -> list[_Candidate]:
    """Return weights at places on each body."""
    found = []
    for effect in simulator.all_effects():
        if effect.family == "payload" and effect.unit == "kg":
            places = simulator.payload_places(str(effect.target), per_axis=PLACES)
            for place in places:
                at = {f"payload[{effect.target}.{axis}]": float(one) for axis, one in zip("xyz", place)}
                found.append(_Candidate(effect, effect.odds / len(places), at))
    return found


def _of_motors(
    offered: Sequence[_Candidate], columns: Array, rows: Rows, value: Array, scales: Array
) -> Array:
    r"""Return columns with those of motors acting on all that is common.

    In units of what its motor exerts a joint lacks :math:`\lambda f - u`, f all of its force and :math:`\lambda` one
    over the gain; nearly u is what a change of :math:`\lambda` multiplies, whatever the model says of f.
    """
    columns, explained = columns.copy(), rows.columns @ value
    for place, one in enumerate(offered):
        if one.effect.family in MOTORS:
            felt = [joint for joint in np.unique(rows.joint) if np.any(columns[rows.joint == joint, place])]
            columns[:, place] -= np.isin(rows.joint, felt) * explained * scales[place]
    return columns


def _distinct(
    offered: Sequence[_Candidate], scales: Array, whitened: Array, noise: Array
) -> tuple[list[_Candidate], Array, Array]:
    """Return candidates that can be seen, of one effect those that act differently, scales, and columns."""
    sizes = np.linalg.norm(whitened, axis=0)
    kept: list[int] = []
    odds = [one.odds for one in offered]
    for place, one in enumerate(offered):
        if sizes[place] < 1e-6 * sizes.max():
            continue
        twins = [
            other
            for other in kept
            if offered[other].effect is one.effect
            and not one.late
            and whitened[:, other] @ whitened[:, place] > ALIKE * sizes[other] * sizes[place]
            and abs(sizes[other] / sizes[place] - 1) < 0.1
        ]
        if twins:
            odds[twins[0]] += one.odds
        else:
            kept.append(place)
    found = [replace(offered[place], odds=odds[place]) for place in kept]
    return found, scales[kept], whitened[:, kept] * noise[:, None]


def _forces(simulator: MujocoSimulator, half: _Half, models: Sequence[_Model]) -> Array:
    """Return the force that models lack for a motion, and by how much measured speeds differ, (n, n_blocks, 2 nv).

    The force of motors counts as it is: a model of motors that do nothing and bodies that weigh nothing would lack no
    force. So forces are over the factor by which a model scales what commands exert on a joint.
    """
    motion, nv = half.motion, len(half.motion.slip)
    found = np.empty((len(models), len(motion.states), 2 * nv))
    for places, scale in _by_scale(simulator, models):
        values = [
            {name: one for name, one in models[place].values.items() if not _is_sensed(name)}
            for place in places
        ]
        commands = np.empty((len(places), *motion.states.shape[:1], motion.commands.shape[1]))
        lates = np.array([models[place].late for place in places])
        for late in np.unique(lates):
            own = np.flatnonzero(lates == late)
            sent = _later(motion.commands, motion.episodes, late)
            acting = simulator.acting_commands(sent, [values[one] for one in own], groups=motion.episodes)
            commands[own] = acting[:, motion.rows].mean(axis=2)
        states, moved = motion.states / np.tile(scale, 2), motion.accelerations / scale
        forces = simulator.missing_forces(states, moved, commands, values, slip=motion.slip)
        found[places, :, :nv] = (
            forces / _strengths(simulator, motion, states, moved, commands, values)[:, None]
        )
        found[places, :, nv:] = half.speeds - states[:, nv:]
        for place in places:
            one = models[place].values
            for joint, name in enumerate(simulator.residual_names[nv:]):
                found[place, :, nv + joint] -= one.get(f"bias[{name}]", 0.0)
                found[place, :, nv + joint] -= (one.get(f"scale[{name}]", 1.0) - 1) * states[:, nv + joint]
    return found


def _is_sensed(name: str) -> bool:
    """Whether an effect is of what scales the motion, or of measured speeds."""
    return name.startswith(("scale[q", "bias[qvel."))


def _by_scale(simulator: MujocoSimulator, models: Sequence[_Model]) -> list[tuple[list[int], Array]]:
    """Return the places of models with equal scales of the positions' sensors, and these, by which speeds scale."""
    names = simulator.residual_names[: len(simulator.residual_names) // 2]
    found: dict[tuple[float, ...], list[int]] = {}
    for place, model in enumerate(models):
        found.setdefault(tuple(model.values.get(f"scale[{name}]", 1.0) for name in names), []).append(place)
    return [(places, np.array(scale)) for scale, places in found.items()]


def _later(commands: Array, episodes: NDArray[np.intp], late: float) -> Array:
    """Return commands that come so many rows later, or, where negative, earlier; interpolated between rows."""
    if not late or not commands.shape[1]:
        return commands
    moved = np.empty_like(commands)
    for episode in np.unique(episodes):
        own = np.flatnonzero(episodes == episode)
        places = np.arange(len(own))
        for column in range(commands.shape[1]):
            moved[own, column] = np.interp(places - late, places, commands[own, column])
    return moved


def _strengths(
    simulator: MujocoSimulator,
    motion: Motion,
    states: Array,
    moved: Array,
    commands: Array,
    values: Sequence[Mapping[str, float]],
) -> Array:
    """Return by which factor models scale what commands exert on each joint, (n, nv); 1 where no motor drives it."""
    found = np.ones((len(values), len(motion.slip)))
    names = [{name for name in one if name.partition("[")[0] in MOTORS} for one in values]
    changed = [place for place, one in enumerate(names) if one]
    if not changed:
        return found
    some = np.unique(np.linspace(0, len(states) - 1, ROWS_FOR_ANCHORS).astype(int))
    plain = {name: value for name, value in values[0].items() if name not in names[0]}
    whole = [plain, *(values[place] for place in changed)]
    sent = np.concatenate([commands[:1, some], commands[changed][:, some]])
    held = np.repeat(sent.mean(axis=1, keepdims=True), len(some), axis=1)
    force = simulator.missing_forces
    exerted = force(states[some], moved[some], sent, whole) - force(states[some], moved[some], held, whole)
    sizes = np.sqrt(np.mean(exerted**2, axis=1))
    found[changed] = np.where(sizes[0] > 0, np.maximum(sizes[1:], WEAKEST * sizes[0]), 1.0) / np.where(
        sizes[0] > 0, sizes[0], 1.0
    )
    return found


def _rows(
    simulator: MujocoSimulator, half: _Half, base: _Model, effects: Sequence[Effect], sizes: Array
) -> Rows:
    """Return the rows of a log about a model, with the columns of effects in units of their sizes."""
    candidates = [_Candidate(effect, 1.0, {}, float(effect.family == "delay")) for effect in effects]
    forces, steps = _steps(simulator, half, base, candidates, sizes)
    whole = np.concatenate([forces[:1], (forces[0] - forces[1:]) / steps[:, None, None]])
    nominal = _forces(simulator, half, [_Model({})])
    coefficients, joint, frequency, stretch = _transformed(half, np.concatenate([whole, nominal]))
    return Rows(coefficients[:, 0], coefficients[:, 1:-1], joint, frequency, stretch, coefficients[:, -1])


def _columns(
    simulator: MujocoSimulator, half: _Half, base: _Model, candidates: Sequence[_Candidate], scales: Array
) -> Array:
    """Return the columns of candidates."""
    forces, steps = _steps(simulator, half, base, candidates, scales)
    return _transformed(half, (forces[0] - forces[1:]) / steps[:, None, None])[0]


def _steps(
    simulator: MujocoSimulator, half: _Half, base: _Model, candidates: Sequence[_Candidate], scales: Array
) -> tuple[Array, Array]:
    """Return forces of a model, and with a step of each candidate; and the steps, in units of scales."""
    models, steps = [base], []
    for one, scale in zip(candidates, scales):
        step = one.late * simulator.dt if one.late else STEP * scale
        model = one.moved(base, step, simulator.dt)
        if model is None:
            step = -step
            model = one.moved(base, step, simulator.dt)
        models.append(base if model is None else model)
        steps.append(step / scale)
    return _forces(simulator, half, models), np.array(steps)


def _transformed(half: _Half, forces: Array) -> tuple[Array, NDArray[np.intp], Array, NDArray[np.intp]]:
    """Return the cosine coefficients of forces (n, n_blocks, 2 nv) where something was measured, and their places."""
    motion = replace(half.motion, cutoff=np.tile(half.motion.cutoff, 2))
    whole, joint, frequency, stretch = transformed(motion, forces.transpose(1, 2, 0))
    seen = np.isfinite(whole[:, 0])
    return whole[seen], joint[seen], frequency[seen], stretch[seen]


@dataclass(frozen=True)
class _Law:
    """Of what the effects do not explain.

    Attributes
    ----------
    noise : tuple of ndarray
        Deviation of each row of both logs.
    spread : ndarray of shape (n_effects,)
        Variance by which an effect differs from window to window.
    weights : ndarray of shape (n_effects,)
        Precision of what is common.
    value : ndarray of shape (n_effects,)
        What is common, if nothing changed.
    apart : ndarray of shape (n_effects,)
        Variance by which an effect differs between the logs, though nothing changed.
    """

    noise: tuple[Array, Array]
    spread: Array
    weights: Array
    value: Array
    apart: Array


def _settled(sides: Sequence[Rows]) -> _Law:
    """Return noise of each row, variances of effects between windows, and what is common; by turns.

    The second log has effects of its own, so that a change makes no variance.
    """
    k = sides[0].columns.shape[1]
    together = _joined(sides)
    first = np.arange(len(together.target)) < len(sides[0].target)
    masks = first, ~first
    noise = noise_of(together, together.target**2, flat=True)
    spread, weights = np.full(k, BEGUN**2), np.r_[np.ones(k), np.full(k, BEGUN**-2)]
    maps = np.eye(k, 2 * k), np.hstack([np.eye(k), np.eye(k)])
    for turn in range(2 * NOISE_TURNS):
        squares = np.empty(len(noise))
        for turn_of_window in range(WINDOW_TURNS):
            windows = [_Windows.of(rows, noise[own]) for rows, own in zip(sides, masks)]
            (G0, h0), (G1, h1) = (one.without(spread).every() for one in windows)
            H = np.block([[G0 + G1 + np.diag(weights[:k]), G1], [G1, G1 + np.diag(weights[k:])]])
            law = np.linalg.inv(H)
            solved = law @ np.r_[h0 + h1, h1]
            moments, told = np.zeros(k), np.zeros(k)
            for rows, own, window, map_ in zip(sides, masks, windows, maps):
                value, cover = map_ @ solved, map_ @ law @ map_.T
                for place, one in enumerate(np.unique(rows.stretch)):
                    G, h = window.products[place], window.projections[place]
                    inner = np.linalg.inv(G + np.diag(1 / spread))
                    apart = inner @ G
                    mean = inner @ h - apart @ value
                    moments += mean**2
                    told += 1 - (np.diag(inner) + np.sum((apart @ cover) * apart, axis=1)) / spread
                    if turn_of_window < WINDOW_TURNS - 1:
                        continue
                    mine = rows.stretch == one
                    N = rows.columns[mine] / noise[own][mine, None]
                    seen = N - N @ apart
                    lever = np.sum((N @ inner) * N, axis=1) + np.sum((seen @ cover) * seen, axis=1)
                    left = rows.target[mine] - rows.columns[mine] @ (value + mean)
                    squares[np.flatnonzero(own)[mine]] = left**2 / np.maximum(1 - lever, 0.1)
            # MacKay's fixed point: squares over how many of them the rows tell, and not the law itself.
            spread = (moments + PSEUDO * APART_AT_LEAST**2) / (np.maximum(told, 0) + PSEUDO)
            weights = 2 / (1 + solved**2)
        noise = noise_of(together, squares, flat=turn < NOISE_TURNS)
    return _Law((noise[first], noise[~first]), spread, weights[:k], solved[:k], np.zeros(k))


def _unlike(halves: Sequence[_Half]) -> Array:
    """Return of each joint the share of the variance of its motion that is between the logs, not within, (nv,).

    A window's motion is told by its mean place, and by the logarithms of its rms speed and acceleration.
    """
    found = []
    for half in halves:
        motion, nv = half.motion, len(half.motion.slip)
        own = [motion.stretches == one for one in np.unique(motion.stretches)]
        q, v, a = motion.states[:, :nv], motion.states[:, nv:], motion.accelerations
        found.append(
            np.array(
                [
                    [
                        q[one].mean(axis=0),
                        *(0.5 * np.log(np.mean(x[one] ** 2, axis=0) + 1e-12) for x in (v, a)),
                    ]
                    for one in own
                ]
            )
        )
    n0, n1 = map(len, found)
    within = sum(((one - one.mean(axis=0)) ** 2).sum(axis=0) for one in found) / max(n0 + n1 - 2, 1)
    apart = 0.5 * (found[0].mean(axis=0) - found[1].mean(axis=0)) ** 2
    between = np.maximum(apart - 0.5 * within * (1 / n0 + 1 / n1), 0)
    return np.asarray(np.max(between / np.maximum(between + within, 1e-12), axis=0))


def _apart(simulator: MujocoSimulator, halves: Sequence[_Half], sides: Sequence[Rows], law: "_Law") -> Array:
    """Return the variance by which effects may differ between logs that move otherwise, though nothing changed.

    What a model leaves of a joint's force may look, by a share, like any effect on it; what the noise of sensors makes
    of it is no misfit.
    """
    rows, left = _joined(sides), np.concatenate(law.noise) ** 2
    read = _of_sensors(simulator, halves, rows)
    unlike = np.tile(_unlike(halves), 2)
    joints = np.unique(rows.joint)
    own = [rows.joint == joint for joint in joints]
    exerted = np.array([np.sum(rows.columns[one] ** 2, axis=0) for one in own])
    # Of the frequencies at which an effect acts.
    remains = np.array([one.sum() * ((left - read)[one] @ rows.columns[one] ** 2) for one in own])
    feels = np.argmax(exerted / np.array([np.sum(rows.nominal[one] ** 2) for one in own])[:, None], axis=0)
    # Of an effect that several joints feel it would have to look alike on each.
    worst = 1 / np.maximum(np.sum(exerted**2 / np.maximum(remains, 1e-300), axis=0), 1e-300)
    return np.asarray(APART * unlike[joints[feels]] * (law.spread + worst) + 1e-12)


def _of_sensors(simulator: MujocoSimulator, halves: Sequence[_Half], rows: Rows) -> Array:
    """Return the variance of rows that the noise of positions makes, by motions that were read anew."""
    squares = []
    for half in halves:
        motions = [
            half.motion,
            *(replace(half.motion, states=q, accelerations=a) for q, a in half.motion.anew),
        ]
        forces = np.concatenate(
            [_forces(simulator, replace(half, motion=motion), [_Model({})]) for motion in motions]
        )
        squares.append(np.mean(_transformed(half, forces[1:] - forces[:1])[0] ** 2, axis=1))
    return smooth_squares(rows, np.concatenate(squares))


def _joined(sides: Sequence[Rows]) -> Rows:
    # Both logs have one noise: with one each, a fit may give one of them up.
    return Rows(
        *(np.concatenate([getattr(side, name) for side in sides]) for name in Rows.__dataclass_fields__)
    )


def _base(simulator: MujocoSimulator, half: _Half, rows: Rows, law: _Law) -> _Model:
    """Return the model with commands as late as they come in the first log."""
    if not half.motion.commands.shape[1]:
        return _Model({})
    models = [_Model({}, late) for late in LATE_IN_BOTH]
    targets = _transformed(half, _forces(simulator, half, models))[0]
    deviation, worth = law.noise[0], []
    for target in targets.T:
        windows = _Windows.of(replace(rows, target=target), deviation)
        G, h = windows.without(law.spread).every()
        square = float(np.sum((target / deviation) ** 2))
        square -= sum(map(partial(_own_share, spread=law.spread), windows.products, windows.projections))
        worth.append(float(h @ np.linalg.solve(G + np.diag(law.weights), h)) - square)
    return _Model({}, LATE_IN_BOTH[int(np.argmax(worth))])


def _within(effect: Effect, value: float) -> float:
    """Return a value within the bounds; no factor so small that a machine would not be one."""
    low, high = effect.bounds
    return float(np.clip(value, max(low, WEAKEST) if effect.neutral == 1 else low, high))


def _own_share(products: Array, projections: Array, spread: Array) -> float:
    """Return by how much the square of a window falls with effects of its own."""
    k = len(spread)
    return float(projections[:k] @ np.linalg.solve(products[:k, :k] + np.diag(1 / spread), projections[:k]))


def _laws(question: _Question) -> Priors:
    """Return the priors of differences, those of the effects; what is taken off again is a change, too."""
    odds = np.array([one.odds for one in question.candidates])
    high = np.array([one.effect.bounds[1] - one.effect.neutral for one in question.candidates])
    low = np.array(
        [
            max(one.effect.bounds[0] - 1, WEAKEST - 1) if one.is_factor else -most
            for one, most in zip(question.candidates, high)
        ]
    )
    # One over a gain is searched for: from 1 / WEAKEST to that of a motor that turns the other way.
    motors = np.array([one.effect.family in MOTORS for one in question.candidates], dtype=bool)
    low, high = np.where(motors, 1 - 1 / WEAKEST, low), np.where(motors, 2.5, high)
    # A chord is a delay at its end alone: a mean of commands of two times is none.
    nearest = question.simulator.dt * np.array(
        [_between(one.late) if one.late else (0, 0) for one in question.candidates]
    )
    late = np.array([bool(one.late) for one in question.candidates])
    low, high = np.where(late, nearest[:, 0], low), np.where(late, nearest[:, 1], high)
    names = tuple(one.effect.name for one in question.candidates)
    scales = question.scales
    return Priors(names, np.ones(len(names)), np.log(odds / (odds.sum() + 1)), low / scales, high / scales)


def _between(late: float) -> tuple[float, float]:
    """Return between how many rows commands are late for which a grid has one value."""
    ends = (LATER[0] / 2, *(0.5 * (one + other) for one, other in itertools.pairwise(LATER)), LATER[-1] + 0.5)
    place = LATER.index(abs(late))
    low, high = sorted(np.sign(late) * np.array(ends[place : place + 2]))
    return float(low), float(high)


def _at_bounds(best: Weighed, candidates: Sequence[_Candidate], priors: Priors) -> list[int]:
    """Return the members at an end of what is possible: a sign that something else is behind them."""
    return [
        place
        for place, value in zip(best.members, best.values)
        if not candidates[place].late and not priors.low[place] * INSIDE < value < priors.high[place] * INSIDE
    ]


def _rivals(candidates: Sequence[_Candidate]) -> dict[int, list[int]]:
    """Return which candidates exclude each other: of one effect, all of a family and each of it."""
    rivals = rivals_of([one.effect for one in candidates])
    for place, one in enumerate(candidates):
        same = [other for other, two in enumerate(candidates) if two.effect is one.effect and other != place]
        rivals.setdefault(place, []).extend(same)
    return rivals


@dataclass(frozen=True)
class _Common:
    """What is common: beside differences from neutral it is ``level - slopes @ differences``; and by the first log."""

    level: Array
    slopes: Array
    alone: Array


def _integrated_sides(question: _Question) -> tuple[_Windows, _Windows]:
    """Return the windows of the first log, and those of the second that fit, without effects of their own."""
    law, kept = question.law, ~question.held_out
    rows = question.sides[0], _part(question.sides[1], kept)
    first, second = (
        _Windows.of(side, noise).without(law.spread)
        for side, noise in zip(rows, (law.noise[0], law.noise[1][kept]))
    )
    return first, second


def _drawn(sides: Sequence[_Windows]) -> list[tuple[Array, ...]]:
    """Return how often each window of either log is in each pair of logs of drawn windows."""
    rng = np.random.default_rng(0)
    counts = [len(side.products) for side in sides]
    return [tuple(rng.multinomial(n, np.full(n, 1 / n)).astype(float) for n in counts) for _ in range(BAGS)]


def _differences(
    question: _Question, sides: tuple[_Windows, _Windows], times: Sequence[Array] | None = None
) -> tuple[Gram, _Common]:
    """Return the Gram matrix of differences with all else integrated out, and what is common given them.

    ``times`` says how often each window of either log counts; once, by default.
    """
    law, k = question.law, len(question.effects)
    (G, h), second = (
        (side.every() if times is None else side.drawn(times[place])) for place, side in enumerate(sides)
    )
    products, projections = _integrated(*second, np.arange(k), 1 / law.apart)
    H = products[:k, :k] + G + np.diag(law.weights)
    right = np.column_stack([projections[:k] + h, products[:k, k:]])
    solved = np.linalg.solve(H, right)
    cross = products[k:, :k]
    gram = Gram(
        products[k:, k:] - cross @ solved[:, 1:],
        projections[k:] - cross @ solved[:, 0],
        np.zeros(len(question.candidates)),
    )
    alone = np.linalg.solve(G + np.diag(law.weights), h)
    return gram, _Common(*(np.asarray(one, dtype=float) for one in (solved[:, 0], solved[:, 1:], alone)))


def _bagged(
    question: _Question,
    sides: tuple[_Windows, _Windows],
    drawn: Sequence[tuple[Array, ...]],
    gram: Gram,
    priors: Priors,
) -> _Bagged:
    """Return the worth of sets over drawn windows; the likely ones of both logs and the best of each pair are seen."""
    rivals = _rivals(question.candidates)
    best, whole = search_sets(gram, priors, {}, rivals=rivals)
    pool = sorted(whole.seen, key=lambda members: -whole.seen[members].evidence)[:POOL]
    found = [
        search_sets(_differences(question, sides, times)[0], priors, {}, start=best.members, rivals=rivals)
        for times in drawn
    ]
    likely = list(dict.fromkeys([(), *pool, *(one.members for one, _ in found)]))
    worth = _Bagged(whole, [one for _, one in found], likely)
    for members in likely:
        worth(members)
    return worth


def _causes(
    question: _Question, best: Weighed, worth: Weigher, nats: Mapping[int, float]
) -> tuple[Cause, ...]:
    if not best.members:
        return ()
    errors = np.sqrt(np.maximum(np.diag(np.linalg.inv(best.curvature)), 0.0))
    others = alternatives(worth(best.members), worth, np.log(ALIAS_ODDS))
    found = []
    for place, value, error in zip(best.members, best.values, errors):
        one = question.candidates[place]
        aliases: dict[str, float] = {}
        for other, lost in others[place]:
            name = question.candidates[other].effect.name
            if name != one.effect.name:
                aliases[name] = aliases.get(name, 0.0) + float(np.exp(-lost))
        total = 1 + sum(aliases.values()) + float(np.exp(-nats[place]))
        told = [
            float(one.told(at * question.scales[place]))
            for at in (value, *(value + WIDTH_95 * error * np.array([-1, 1])))
        ]
        centre = told[0]
        found.append(
            Cause(
                name=one.effect.name,
                family=one.effect.family,
                target=one.effect.target,
                value=centre,
                interval=(told[1], told[2]),
                unit=one.effect.unit,
                probability=1 / total,
                evidence=float(nats[place]),
                aliases=tuple(
                    Alias(name, share / total)
                    for name, share in sorted(aliases.items(), key=lambda pair: -pair[1])
                ),
                sentence=_sentence(one, centre),
            )
        )
    return tuple(sorted(found, key=lambda cause: -cause.evidence))


def _sentence(one: _Candidate, value: float) -> str:
    words = one.effect.meaning
    if one.is_factor:
        return f"{words} is {value:.4g} times what it was"
    unit = "" if one.effect.unit == "1" else f" {one.effect.unit}"
    place = ""
    if one.beside:
        place = ", about at (" + ", ".join(f"{at:.2g}" for at in one.beside.values()) + ") m"
    return f"{words}: {abs(value):.4g}{unit} {'more' if value > 0 else 'less'} than it was{place}"


def _left(question: _Question, value: Array, differences: Array) -> tuple[Array, Array]:
    """Return what common values and differences leave of the rows of both logs."""
    first, second = question.sides
    step = np.r_[value, differences]
    return first.target - first.columns @ value, second.target - second.columns @ step


def _gain(question: _Question, value: Array, differences: Array) -> Gain | None:
    """Return the gain on the windows that were held out."""
    mine = question.held_out
    if not mine.any():
        return None
    nominal = _left(question, value, np.zeros(len(question.candidates)))[1][mine]
    extended = _left(question, value, differences)[1][mine]
    noise, rows = question.law.noise[1][mine], question.sides[1]
    windows = [rows.stretch[mine] == one for one in np.unique(rows.stretch[mine])]
    squares = np.array(
        [[float(np.sum((one[own] / noise[own]) ** 2)) for one in (nominal, extended)] for own in windows]
    )
    counts = np.array([int(own.sum()) for own in windows])
    errors = squares.sum(axis=0) / counts.sum()
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(windows), size=(BOOTSTRAPS, len(windows)))
    some = squares[drawn].sum(axis=1) / counts[drawn].sum(axis=1)[:, None]
    shares = (some[:, 0] - some[:, 1]) / np.maximum(some[:, 0] - 1, 1e-12)
    low, high = np.percentile(shares, [2.5, 97.5]) if len(windows) >= 5 else (np.nan, np.nan)
    excess = errors[0] - 1
    return Gain(
        nominal=float(errors[0]),
        extended=float(errors[1]),
        floor=1.0,
        explained=float((errors[0] - errors[1]) / excess) if excess > 0 else 0.0,
        interval=(float(low), float(high)),
        horizon=0.0,
        channels={
            name: (_rms(nominal, own), _rms(extended, own))
            for joint, name in enumerate(_dof_names(question.simulator))
            if (own := rows.joint[mine] == joint).any()
        },
    )


def _dof_names(simulator: MujocoSimulator) -> tuple[str, ...]:
    return tuple(simulator.residual_names[len(simulator.residual_names) // 2 :])


def _rms(values: Array, chosen: Mask) -> float:
    return float(np.sqrt(np.mean(values[chosen] ** 2)))


def _sizes(question: _Question, value: Array) -> dict[str, tuple[float, float]]:
    """Return rms of the force that the model as it is lacks, and of what is left with what is common in it."""
    rows = _joined([replace(side, columns=side.columns[:, :0]) for side in question.sides])
    left = np.concatenate(_left(question, value, np.zeros(len(question.candidates))))
    return {
        name: (_rms(rows.nominal, rows.joint == joint), _rms(left, rows.joint == joint))
        for joint, name in enumerate(_dof_names(question.simulator))
    }


def _mistake(
    question: _Question,
    differences: Array,
    price: float,
    common: _Common,
    drawn: Sequence[tuple[Array, ...]],
    needed: float,
) -> str:
    """Return how columns of the second log seem to be mixed up, if that explains it better than all changes.

    As changes do, it has to hold in drawn windows. Changes cost their price: by how much their evidence is less than
    what they explain.
    """
    simulator = question.simulator
    known = {effect.name: (effect, size) for effect, size in zip(question.effects, question.sizes)}
    values = dict(question.base.values)
    for (name, (effect, size)), one in zip(known.items(), common.alone):
        values[name] = _within(effect, values.get(name, effect.neutral) + size * one)
    model = replace(question.base, values=values)
    mixed = [_mixed_up(simulator, half) for half in question.halves]
    if not mixed[0]:
        return ""
    kept = np.ones(len(question.sides[0].target), dtype=bool), ~question.held_out

    def misfits(side: int) -> tuple[Array, Array]:
        """Return half the log of what is left over the noise, of all drawn windows, as columns are and in other orders.

        Of two joints that change places, as far as both were fast: beyond, one of them has no rows.
        """
        own, rows, noise = question.halves[side], question.sides[side], question.law.noise[side]
        windows, window = np.unique(rows.stretch[kept[side]], return_inverse=True)
        joints, joint = np.unique(rows.joint[kept[side]], return_inverse=True)
        times = np.array([one[side] for one in drawn])

        def left(half: _Half) -> Array:
            motion = replace(half.motion, cutoff=own.motion.cutoff)
            forces = _forces(simulator, half, [model])
            return _transformed(replace(half, motion=motion), forces)[0][:, 0]

        def misfit(squares: Array, seen: Mask) -> Array:
            shape = len(windows), len(joints)
            place = np.ravel_multi_index((window, joint), shape)
            sums, counts = (
                np.bincount(place, some[kept[side]], minlength=shape[0] * shape[1]).reshape(shape)
                for some in (squares * seen, seen.astype(float))
            )
            many = np.maximum(times @ counts, 1)
            return np.asarray(0.5 * np.sum(many * np.log1p(times @ sums / many), axis=1))

        given = left(own) - (rows.columns[:, len(question.effects) :] @ differences if side else 0.0)
        as_is, otherwise = [], []
        for _, half in mixed[side]:
            seen = rows.frequency <= np.tile(half.motion.cutoff, 2)[rows.joint]
            as_is.append(misfit((given / noise) ** 2, seen))
            otherwise.append(misfit((left(half) / noise) ** 2, seen))
        return np.array(as_is), np.array(otherwise)

    first, second = misfits(0), misfits(1)
    # What as well mends the first log is the model's matter.
    share = kept[1].sum() / kept[0].sum()
    mended = second[0] + price - second[1] - share * np.maximum(first[0] - first[1], 0)
    # Probabilities of none of them, and of each, in each draw; their means, as of sets of changes.
    logs = np.vstack([np.zeros(mended.shape[1]), mended + np.log(MIXED_UP / len(mended))])
    means = logsumexp(logs - logsumexp(logs, axis=0), axis=1)
    best = int(np.argmax(means[1:]))
    return mixed[1][best][0] if means[1 + best] - means[0] > needed else ""


def _mixed_up(simulator: MujocoSimulator, half: _Half) -> list[tuple[str, _Half]]:
    """Return halves with columns in the order, and with the sign, that they may have been meant to have."""
    motion, nv = half.motion, len(half.motion.slip)
    joints = simulator.residual_names[:nv]
    controls = simulator.input_names[len(simulator.state_names) :]
    found = []
    for index, name in enumerate(controls):
        signs = np.where(np.arange(len(controls)) == index, -1.0, 1.0)
        found.append(
            (
                f"{name} has its sign turned",
                replace(half, motion=replace(motion, commands=motion.commands * signs)),
            )
        )
    for index, name in enumerate(joints):
        signs = np.where(np.arange(nv) == index, -1.0, 1.0)
        turned = replace(
            motion, states=motion.states * np.tile(signs, 2), accelerations=motion.accelerations * signs
        )
        found.append(
            (f"{name} has its sign turned", replace(half, motion=turned, speeds=half.speeds * signs))
        )
    for one, other in itertools.combinations(range(len(controls)), 2):
        order = _swapped(len(controls), one, other)
        swapped = replace(motion, commands=motion.commands[:, order])
        found.append((f"{controls[one]} and {controls[other]} are swapped", replace(half, motion=swapped)))
    for one, other in itertools.combinations(range(nv), 2):
        if simulator.units[joints[one]] == simulator.units[joints[other]]:
            order = _swapped(nv, one, other)
            swapped = replace(
                motion,
                states=motion.states[:, np.r_[order, order + nv]],
                accelerations=motion.accelerations[:, order],
                cutoff=np.minimum(motion.cutoff, motion.cutoff[order]),
            )
            found.append(
                (
                    f"{joints[one]} and {joints[other]} are swapped",
                    replace(half, motion=swapped, speeds=half.speeds[:, order]),
                )
            )
    return found


def _swapped(n: int, one: int, other: int) -> NDArray[np.intp]:
    order = np.arange(n)
    order[[one, other]] = other, one
    return order
