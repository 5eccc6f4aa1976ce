"""The regression of two logs, of effects that may be wrong in both, and of candidates that may have changed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skat.diagnosis.chains import Array, Mask
from skat.diagnosis.changes.candidates import distinct, offered_candidates, units_of
from skat.diagnosis.changes.law import Law, settled_law, with_misfit
from skat.diagnosis.changes.windows import total, windows_of
from skat.diagnosis.forces.force_space import Motion, Rows, joined
from skat.diagnosis.forces.machines import MOTORS, UNSEEN, WEAKEST, Candidate, Model
from skat.diagnosis.forces.motions import (
    SHOWN,
    coefficients_of,
    columns_of,
    lacking_forces,
    rows_about,
    shares_of,
    units_by,
    with_friction,
)
from skat.effects import Effect
from skat.simulators import MujocoSimulator

# Rows by which commands may come late, or early: of a row that a smoothed motion and a time step blur.
LATE_IN_BOTH = tuple(0.25 * one for one in range(-16, 33))
# Of what something is to explain, that it explains at least.
MOST = 0.5
# Turns of the machines about which forces are linear, and of what is wrong in both logs or was found to differ.
TURNS = 3
# Odds of a fault of its own: a motor lost nearly all that it exerts, or columns of a log were mixed up.
FAULT = 1e-3
# Of the way to where slopes lead, so far machines may move.
SHARES = np.r_[0.0, np.power(2.0, np.arange(-5, 1))]


@dataclass(frozen=True)
class Machines:
    """The machines of two logs, and effects in which they differ from a base.

    Attributes
    ----------
    simulator : MujocoSimulator
    halves : tuple of Motion
        The first log and the second.
    base : Model
        From which effects are counted.
    effects : tuple of Effect
        That may be wrong in both logs.
    sizes : ndarray of shape (n_effects,)
        Typical ones, each in its effect's unit: units of values and columns.
    """

    simulator: MujocoSimulator
    halves: tuple[Motion, ...]
    base: Model
    effects: tuple[Effect, ...]
    sizes: Array

    def model(self, value: Array) -> Model:
        """Return a machine with what is common, (n_effects,), in it, as far as it may have that."""
        values = dict(self.base.values)
        for effect, size, one in zip(self.effects, self.sizes, value):
            whole = values.get(effect.name, effect.neutral) + size * one
            values[effect.name] = float(np.clip(whole, *_bounds(effect)))
        return replace(self.base, values=values)

    def possible(self) -> tuple[Array, Array]:
        """Return between which values, (n_effects,), a machine may have effects."""
        ends = np.array([_bounds(effect) for effect in self.effects])
        here = np.array([self.base.values.get(effect.name, effect.neutral) for effect in self.effects])
        low, high = (ends - here[:, None]).T / self.sizes
        return low, high

    def rows(self, log: int, machine: Model, driven_by: Model) -> Rows:
        """Return the rows of a log about a machine that moves by a model."""
        more = {"machine": machine, "driven_by": driven_by}
        return rows_about(self.simulator, self.halves[log], self.base, self.effects, self.sizes, **more)

    def squares_lacking(self, log: int, rows: Rows, law: Law, machines: Sequence[Model]) -> Array:
        """Return the squares of what machines lack in a log, over the noise and what windows have of their own.

        Of shape (n_machines,), in units of what their motors exert: else those lacked least whose motors do nothing.
        """
        left = coefficients_of(self.halves[log], lacking_forces(self.simulator, self.halves[log], machines))[
            0
        ]
        for place, effect in enumerate(self.effects):
            if effect.family in MOTORS:
                driven = np.isin(rows.joint, rows.joint[rows.columns[:, place] != 0])
                factors = np.abs([machine.values.get(effect.name, 1.0) for machine in machines])
                left[driven] /= np.maximum(factors, WEAKEST)
        return _squares(rows, left, law, law.noise[log])


@dataclass(frozen=True)
class Question(Machines):
    """The regression of two logs of a machine.

    Attributes
    ----------
    candidates : tuple of Candidate
        That may have changed.
    scales : ndarray of shape (n_candidates,)
        Their typical sizes, each in its effect's unit: units of the columns.
    here : ndarray of shape (n_effects,)
        The first log's machine, about which its forces are linear, in units of sizes from the base.
    sides : tuple of Rows
        Of both logs. Columns are those of effects; in the second log, then those of candidates.
    later : ndarray of shape (n_rows of the first log, n_late)
        Columns of candidates that are late in the first log: a chord is no effect's slope, and what it looks like there
        may be wrong in both logs, too.
    law : Law
    held_out : ndarray of bool of shape (n_rows of the second log,)
        Which rows of the second log measure the gain.
    weak : tuple of str
        Effects of motors that do next to nothing in the second log, by which rows are about machines without them.
    """

    candidates: tuple[Candidate, ...]
    scales: Array
    here: Array
    sides: tuple[Rows, Rows]
    later: Array
    law: Law
    held_out: Mask
    weak: tuple[str, ...] = ()

    @property
    def machine(self) -> Model:
        """The first log's machine, of which factors are told as multiples."""
        return self.model(self.here)

    def about(self, value: Array, differences: Array) -> "Question":
        """Return the same regression, linear about what the second log's machine is with such differences in it.

        Parameters
        ----------
        value : ndarray of shape (n_effects,)
            What is common, in units of sizes: machines go as far there as both logs lack less by.
        differences : ndarray of shape (n_candidates,)
            In units of scales.
        """
        scales = self.scales * units_of(self.candidates, self.machine)
        path = self.here + np.multiply.outer(SHARES, value - self.here)
        starts = [self.model(one) for one in path]
        ends = [self._moved(start, differences) for start in starts]
        lacking = sum(
            self.squares_lacking(log, self.sides[log], self.law, machines)
            for log, machines in enumerate((starts, ends))
        )
        best = np.argmin(lacking + np.sum(self.law.weights * path**2, axis=1))
        # Forces are linear in a weight; of how late commands come a chord tells, no slope.
        bent = np.array([not one.late and not one.beside for one in self.candidates], dtype=bool)
        machine = self._moved(starts[best], differences * bent)
        new, simulator, half = self.rows(1, machine, ends[best]), self.simulator, self.halves[1]
        columns = columns_of(simulator, half, machine, self.candidates, scales, driven_by=ends[best])
        # Of effects that may be wrong in both logs it is counted from the base already.
        further = [
            one.effect not in self.effects and one.effect.name in machine.values for one in self.candidates
        ]
        target = new.target + columns @ (differences * bent * further)
        second = replace(self.sides[1], target=target, columns=np.column_stack([new.columns, columns]))
        return replace(self, sides=(self.sides[0], second))

    def _moved(self, machine: Model, differences: Array) -> Model:
        """Return a machine with differences in it, those that it may have."""
        scales = self.scales * units_of(self.candidates, self.machine)
        for place in np.flatnonzero(differences):
            step = differences[place] * scales[place]
            machine = self.candidates[place].moved(machine, step, self.simulator.dt) or machine
        return machine

    def lacking(self, sets: Sequence[tuple[Array, Array]]) -> Array:
        """Return what the second log's machine lacks at values and differences, (n_sets,), see `squares_lacking`."""
        models = [self._moved(self.model(value), step) for value, step in sets]
        return self.squares_lacking(1, self.sides[1], self.law, models)

    def left(self, value: Array, differences: Array) -> tuple[Array, Array]:
        """Return what values (n_effects,) and differences (n_candidates,) leave of the rows of both logs, (n_rows,)."""
        first, second = self.sides
        step = np.r_[value, differences]
        return first.target - first.columns @ value, second.target - second.columns @ step


def question_of(
    simulator: MujocoSimulator,
    halves: Sequence[Motion],
    effects: Sequence[Effect],
    *,
    typical: Mapping[str, float],
    test_size: float,
    needed: float,
) -> Question:
    """Return the regression about what is common of motors and delays, with its noise.

    Parameters
    ----------
    simulator : MujocoSimulator
    halves : sequence of Motion
        The first log and the second.
    effects : sequence of Effect
        That may be wrong in both logs or may have changed.
    typical : mapping from name to size
        Scales of the priors of a user's own, each in its effect's unit.
    test_size : float
        Share of the second log that measures the gain.
    needed : float
        By how much logs have to be likelier where commands are later in one than in the other, nats.
    """
    seen = [effect for effect in effects if effect.family not in UNSEEN]
    common = [effect for effect in seen if effect.target != "all"]
    sizes = np.array([typical.get(effect.name, effect.typical) for effect in common])
    sides = [rows_about(simulator, half, Model({}), common, sizes) for half in halves]
    shares = shares_of(joined(sides))
    shown = np.flatnonzero(shares > SHOWN)
    common, sizes, shares = [common[place] for place in shown], sizes[shown], shares[shown]
    units = units_by(shares, common, typical)
    sizes = sizes * units
    sides = [replace(side, columns=side.columns[:, shown] * units) for side in sides]
    sides = [with_friction(simulator, *one, common, sizes) for one in zip(halves, sides)]
    logs = Machines(simulator, tuple(halves), Model({}), tuple(common), sizes)
    base, late = _bases(logs, sides, needed)
    logs = replace(logs, base=base)
    (here, there), sides, law, weak = _about_machines(logs, late, needed)
    first, second = logs.model(here), logs.model(there)
    offered, scales = offered_candidates(simulator, effects, common, sizes, typical)
    units = scales * units_of(offered, first)
    columns = columns_of(simulator, halves[1], second, offered, units, driven_by=second)
    noise = law.noise[1]
    whitened = columns / noise[:, None]
    offered, kept = distinct(offered, whitened)
    sides[1] = replace(
        sides[1], columns=np.column_stack([sides[1].columns, whitened[:, kept] * noise[:, None]])
    )
    chords = [place for place, one in zip(kept, offered) if one.late]
    later = [one for one in offered if one.late]
    return Question(
        **vars(logs),
        candidates=tuple(offered),
        scales=scales[kept],
        here=here,
        sides=(sides[0], sides[1]),
        later=columns_of(simulator, halves[0], first, later, units[chords], driven_by=first),
        law=law,
        held_out=_held_out(sides[1].stretch, test_size),
        weak=weak,
    )


def _about_machines(
    logs: Machines, late: float, needed: float
) -> tuple[tuple[Array, Array], list[Rows], Law, tuple[str, ...]]:
    """Return machines of the first log and the second, (n_effects,) in units of sizes, rows about them, and their law.

    ``late`` is by how many rows commands come late in the second log, if nothing else differs. About a motor that
    works slopes do not lead to one that does not: its commands would be noise. Of that the second log is asked, with
    ``needed`` nats; effects of such motors are the last of what is returned.
    """
    weak: dict[int, float] = {}
    while True:
        about, rows, law = _settled_machines(logs, late, weak)
        own = [rows[0], rows[-1]]
        found = _weak_motor(logs, own, law, late, about, weak, needed)
        if not found:
            return about, rows[:2], with_misfit(own, law), tuple(logs.effects[place].name for place in weak)
        weak |= found


def _settled_machines(
    logs: Machines, late: float, weak: Mapping[int, float]
) -> tuple[tuple[Array, Array], list[Rows], Law]:
    """Return machines of both logs by turns, rows about them, and their law.

    The last of the rows, to which the law belongs, are of the second log with its commands ``late``. With motors that
    are ``weak`` there, values by places of their effects, nothing known drives the second log's machine, whose forces
    scale with what it weighs: it is the first log's with these motors.
    """
    values = np.zeros((2, len(logs.effects)))
    lates, ends = (logs.base.late, late), logs.possible()
    for _ in range(TURNS):
        if weak:
            values[1] = values[0]
            values[1, list(weak)] = list(weak.values())
        about = values.copy()
        first, second = (logs.model(value) for value in about)
        asked = [(0, first), (1, second), (1, replace(second, late=late))]
        rows = [logs.rows(log, one, one) for log, one in asked[: 2 if second.late == late else 3]]
        own = [rows[0], rows[-1]]
        law = settled_law(own, ends)
        for log, there in enumerate((law.value, law.second)):
            path = values[log] + np.multiply.outer(SHARES, there - values[log])
            machines = [replace(logs.model(value), late=lates[log]) for value in path]
            lacking = logs.squares_lacking(log, own[log], law, machines)
            values[log] = path[np.argmin(lacking + np.sum(law.weights * path**2, axis=1))]
    return (about[0], about[1]), rows, law


def _weak_motor(
    logs: Machines,
    sides: Sequence[Rows],
    law: Law,
    late: float,
    about: tuple[Array, Array],
    known: Mapping[int, float],
    needed: float,
) -> dict[int, float]:
    """Return the place of the effect of a further motor that does next to nothing in the second log, and its value.

    In units of its size; empty if there is none beside those that are known. It is one where the first log's machine
    with such a motor lacks less on its joint in the second log than both logs' machines do, and than it does where that
    motor's commands are turned, which is a fault, too; and more in the first log: else it is the model's matter.
    """
    most, found = needed - np.log(FAULT), {}
    commands = np.array(logs.simulator.input_names[len(logs.simulator.state_names) :])
    for place, effect in enumerate(logs.effects):
        joints = sides[0].joint[sides[0].columns[:, place] != 0]
        if effect.family not in MOTORS or place in known or not len(joints):
            continue
        weak = np.tile(about[0], (3, 1))
        factors = np.clip([-WEAKEST, 0.0, WEAKEST], *effect.bounds)
        weak[:, place] = (factors - logs.base.values.get(effect.name, 1.0)) / logs.sizes[place]
        signs = np.where(commands == f"ctrl.{effect.target}", -1.0, 1.0)
        gains = []
        for half, rows, noise, come in zip(logs.halves, sides, law.noise, (logs.base.late, late)):
            machines = [replace(logs.model(value), late=come) for value in (*about, *weak)]
            turned = replace(half, commands=half.commands * signs)
            lacking = [
                lacking_forces(logs.simulator, *one) for one in ((turned, machines[:1]), (half, machines))
            ]
            left = coefficients_of(half, np.concatenate(lacking))[0]
            driven = np.isin(rows.joint, joints)
            squares = _squares(rows.part(driven), left[driven], law, noise[driven])
            # Of a noise that is not known: the law's has taken in what a motor that works lacks there.
            gains.append(0.5 * driven.sum() * np.log(squares[1:3].min() / np.maximum(squares[3:], 1e-300)))
        worth = np.where((gains[0] > 0) | (squares[0] <= squares[3:]), 0.0, gains[1])
        if worth.max() > most:
            most, found = worth.max(), {place: float(weak[np.argmax(worth), place])}
    return found


def _squares(rows: Rows, left: Array, law: Law, noise: Array) -> Array:
    """Return the squares of what is left of rows, (n_rows, n), over the noise and what windows have of their own."""
    k = len(law.spread)
    stacked = replace(rows, target=np.zeros(len(left)), columns=np.column_stack([rows.columns[:, :k], left]))
    return np.diag(total(windows_of(stacked, noise, law.spread)).products)[k:]


def _bases(logs: Machines, sides: Sequence[Rows], needed: float) -> tuple[Model, float]:
    """Return a model with dry friction, and commands as late as in the first log; and how late they are in the second.

    Rows are not linear in either: MuJoCo's dry friction is softer the larger it is, and of how late commands come a
    slope tells little. Each log tells by its own rows, so that what differs between them is no noise. What makes them
    likelier by less than a name needs is left out: a joint that creeps shows no dry friction, but damping.
    """
    effects = logs.effects
    prompt = np.array([effect.family != "delay" for effect in effects])
    prompted = [replace(rows, columns=rows.columns * prompt) for rows in sides]
    laws = [settled_law([rows, rows]) for rows in prompted]

    def told(place: int, models: Sequence[Model]) -> tuple[Array, Array]:
        return _told(logs.simulator, logs.halves[place], prompted[place], laws[place], models)

    lates = [Model({}, late) for late in LATE_IN_BOTH]
    (levels, values), (others, further) = told(0, lates), told(1, lates)
    alike = int(np.argmax(levels + others))
    own = int(np.argmax(levels)), int(np.argmax(others))
    if levels[own[0]] + others[own[1]] - levels[alike] - others[alike] <= needed:
        own = alike, alike
    friction = {
        effect.name: float(np.clip(size * value, *effect.bounds))
        for effect, size, value in zip(effects, logs.sizes, 0.5 * (values[own[0]] + further[own[1]]))
        if effect.family == "dry_friction"
    }
    # Of each joint against none, its column left out.
    dry = np.array([effect.family == "dry_friction" for effect in effects])
    prompted = [replace(rows, columns=rows.columns * ~dry) for rows in prompted]
    some = [friction, *({**friction, name: 0.0} for name in friction)]
    gains = np.zeros(len(friction))
    for place, late in enumerate(own):
        every, *without = told(place, [Model(values, LATE_IN_BOTH[late]) for values in some])[0]
        gains += every - np.array(without)
    kept = {name: value for (name, value), gain in zip(friction.items(), gains) if gain > needed}
    one, other = (LATE_IN_BOTH[late] for late in own)
    return Model(kept, one), other


def _told(
    simulator: MujocoSimulator, half: Motion, rows: Rows, law: Law, models: Sequence[Model]
) -> tuple[Array, Array]:
    """Return the log density of a log about models, but for a constant, and all effects, in units of sizes, about each.

    Of shapes (n_models,), nats, and (n_models, n_effects).
    """
    k, weights = rows.columns.shape[1], law.weights
    targets = coefficients_of(half, lacking_forces(simulator, half, models))[0]
    # As columns behind those of effects all targets are integrated over at once.
    columns = np.column_stack([rows.columns, targets])
    stacked = replace(rows, target=np.zeros(len(rows.target)), columns=columns)
    whole = total(windows_of(stacked, law.noise[0], law.spread))
    left = whole.integrated(weights).products
    values = np.linalg.solve(whole.products[:k, :k] + np.diag(weights), whole.products[:k, k:])
    return np.asarray(-0.5 * np.diag(left)[k:]), np.asarray(values.T)


def _bounds(effect: Effect) -> tuple[float, float]:
    """Return the bounds of an effect; no factor is so small that a machine would not be one."""
    low, high = effect.bounds
    return max(low, WEAKEST) if effect.neutral == 1 and effect.family not in MOTORS else low, high


def _held_out(stretch: NDArray[np.intp], share: float) -> Mask:
    """Return which rows are in windows that are held out: a share of them, evenly spread, not all."""
    kinds = np.unique(stretch)
    n = min(round(share * len(kinds)), len(kinds) - 2)
    places = np.linspace(0, len(kinds) - 1, max(n, 0) + 2).astype(int)[1:-1]
    return np.isin(stretch, kinds[places])
