"""What every simulator offers: rows of inputs in, rows of outputs out, under any effects."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator

from skat.effects import Effect, checked_values
from skat.simulators.tables import Array, checked_columns, episode_starts, with_earlier

# Of the bias of a sensor: half a turn, or nothing that a unit of one's own would say.
HALF_TURNS = {"rad": math.pi, "deg": 180.0}
UNBOUNDED = 1e12
# Of a sensor's filter, in transitions.
LONGEST_LAG = 20
# Of its largest value, by how much a hidden state may differ and be the same: far less than any slope sees.
SAME = 1e-9
# Rows that are carried along at once; a step of more of them takes longer.
PIECES = 32
Acting = tuple[Array, ...] | None
# States (n_parts, n_rows, n_states) within rows, of one simulation or of two with the share of the second.
Courses = list[tuple[float, Array]]
Made = TypeVar("Made")


class Simulator(BaseEstimator, ABC):
    """A simulation with named inputs, outputs and effects.

    With ``state_names`` it maps a state and further inputs to the next state: the first inputs are the state,
    and the outputs are the next one. Without, it is one-shot: inputs to outputs.

    Attributes
    ----------
    input_names, output_names, state_names : tuple of str
        Names of columns.
    residual_names : tuple of str
        Names of the columns of a residual; those of the outputs, unless there are quaternions.
    dt : float or None
        Duration of a transition, s; None for one-shot simulations.
    """

    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    state_names: tuple[str, ...]
    built_in: Mapping[str, float] | None
    dt: float | None

    @property
    def residual_names(self) -> tuple[str, ...]:
        """Names of the columns of a residual."""
        return self.output_names

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each column whose unit is known, such as ``"m"`` or ``"rad/s"``, by name."""
        return {}

    @property
    def reference_state(self) -> Array:
        """State to begin with where none was measured, (n_states,): zero, if the model has no place of its own."""
        return np.zeros(len(self.state_names))

    @property
    def angle_names(self) -> tuple[str, ...]:
        """Names of the state's columns that are angles or their rates, in rad or rad/s."""
        return tuple(name for name in self.state_names if self.units.get(name) in ("rad", "rad/s"))

    @property
    def time_step(self) -> float | None:
        """Time within which commands that come late change in a straight line, s; None for one-shot simulations."""
        return self.dt

    @property
    def command_limits(self) -> dict[str, tuple[float, float]]:
        """Range that the simulation clips an input to, by name of the input."""
        return {}

    def effects(self, *, also: Collection[str] | str = ()) -> tuple[Effect, ...]:
        """Return every effect that this simulator can take on and that no other effect listed repeats.

        The values of an effect are relative to this simulator: where an effect is built in already, its
        bounds are what is left of the original ones.

        Parameters
        ----------
        also : str or collection of str, default=()
            Families, or names, of effects that are listed only when asked for, as few machines have them or their
            simulation takes long: lags, delays of single actuators, play, a servo's finer friction, a payload,
            commands in the wrong unit; "all": all of them. `predict` accepts them all, listed or not.
        """
        unlisted, asked = self._unlisted_effects(), self._asked_effects()
        wanted = {also} if isinstance(also, str) else set(also)
        return tuple(
            effect
            for effect in self._by_name.values()
            if effect.name not in unlisted
            and (effect.name not in asked or {"all", effect.name, effect.family} & wanted)
        )

    @property
    def hidden_state_names(self) -> tuple[str, ...]:
        """Names of the states that the rows do not hold, as the simulator is, with what is built in.

        ``act.<actuator>`` (an activation of the model; with a number behind it where there are several),
        ``torque.<actuator>`` (a torque that lags), ``play.<joint>`` and ``play_rate.<joint>`` (of the link against its
        motor), ``ahead.<channel>`` (how far the truth is ahead of what a sensor's filter shows). `predict` begins each
        episode in a steady state and carries them from row to row, `rollout` likewise. What a delay or a lag of the
        commands holds is no such state: it follows from the commands alone.
        """
        total = self._built_in()
        sensors = (f"ahead.{self.state_names[column]}" for column in self._lagging(total))
        return (*self._own_hidden_names(self._physical(total)), *sensors)

    def joint_forces(self) -> tuple[tuple[Effect, tuple[str, ...]], ...]:
        """Return effects that are a force on one joint each, with the inputs of that joint; none unless overridden."""
        return ()

    def parts(self) -> tuple[tuple[str, ...], ...]:
        """Return the channels of a residual, part by part: none acts on one of another part, whatever happens."""
        return (self.residual_names,)

    def part_of(self, effect: str) -> int | None:
        """Return the part that an effect, by its name, acts in alone; None where it may act in several."""
        return None

    def n_lags(self, effects: Mapping[str, float] | None = None) -> int:
        """Return of how many earlier rows the actions still act in a row: a delay, in transitions, rounded up."""
        return self._lags(self._total(effects))

    def coarsely(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return values with about the same slopes, by all but what is left out, that take less time to simulate."""
        return dict(values)

    def predict(
        self, X: ArrayLike, *, effects: Mapping[str, float] | None = None, groups: ArrayLike | None = None
    ) -> Array:
        """Simulate each row.

        Parameters
        ----------
        X : array-like of shape (n_rows, n_inputs)
            Inputs, in the order of ``input_names``. A data frame's columns are matched by name.
        effects : mapping from name to value, optional
            Effects not given are neutral.
        groups : array-like of shape (n_rows,), optional
            Episode of each row; an episode's rows are consecutive and in time order. What has a memory needs it:
            commands that come late or through a filter, of which an episode's first is taken to have held before, and
            hidden states (`hidden_state_names`), which begin steady and are carried along: each row starts from its
            own measured state and from the hidden state that the row before it left. Copies of an episode, with
            displaced states for example, are episodes of their own, with labels of their own. None: all rows are one
            episode.

        Returns
        -------
        ndarray of shape (n_rows, n_outputs)

        Raises
        ------
        RuntimeError
            If the simulation of a row diverged.
        ValueError
            If X has other columns or values that are not finite; if an effect is unknown or out of bounds.
        """
        outputs: Array = self.predict_many(X, [effects or {}], groups=groups)[0]
        diverged = np.flatnonzero(~np.isfinite(outputs).all(axis=1))
        if diverged.size:
            rows = ", ".join(map(str, diverged[:5])) + (", ..." if diverged.size > 5 else "")
            raise RuntimeError(
                f"the simulation diverged in {diverged.size} of {len(outputs)} rows (row {rows}) with "
                f"effects "
                f"{dict(effects or {})}; check that these inputs are physical, or take a smaller time step"
            )
        return outputs

    def predict_many(
        self,
        X: ArrayLike,
        candidates: Sequence[Mapping[str, float]],
        *,
        groups: ArrayLike | None = None,
        past: "Past | None" = None,
        forces: Array | None = None,
        earlier: Array | None = None,
    ) -> Array:
        """Simulate each row under each candidate set of effect values.

        Parameters
        ----------
        X : array-like of shape (n_rows, n_inputs)
        candidates : sequence of mappings from name to value
        groups : array-like of shape (n_rows,), optional
            As in `predict`.
        past : Past, optional
            What these rows have of those before them, as `past` returns it, in place of what `groups` says.
        forces : ndarray of shape (n_rows, n_forces), optional
            Forces on joints besides, in the order of `joint_forces`, N or N m; those of `past`, if that is given.
        earlier : ndarray of shape (n_episodes, n_earlier, n_inputs - n_states), optional
            Commands in the rows before the first one of each episode, the last one last. Without it, or where `past` is
            given, see there.

        Returns
        -------
        ndarray of shape (n_candidates, n_rows, n_outputs)
            Rows whose simulation diverged are NaN.
        """
        inputs = checked_columns(X, self.input_names, "X")
        totals = [self._total(values) for values in candidates]
        outputs = np.empty((len(totals), len(inputs), len(self.output_names)))
        if not totals or not len(inputs):
            return outputs
        times = None
        if past is None:
            past, times = self._begun(inputs, totals, groups, forces, earlier)
        for kind, which in self._by_memory(totals):
            some, before = [totals[index] for index in which], past.under(which)
            true = self._true(inputs, some)
            if kind and times is not None:
                found = self._carry_along(true, some, before, times)
            elif kind:
                found = _Carried(self, some, before).step(true, before.acting, np.arange(len(inputs)))
            else:
                physical = [self._physical(one) for one in some]
                found = self._outputs(true, physical, before.acting, None, before.forces)[0]
            outputs[which] = self._measured(found, some)
        return outputs

    def past(
        self,
        X: ArrayLike,
        candidates: Sequence[Mapping[str, float]],
        *,
        groups: ArrayLike | None = None,
        forces: Array | None = None,
        earlier: Array | None = None,
    ) -> "Past":
        """Return what each row has of the rows before it under each candidate: with it, rows do not need each other.

        Parameters
        ----------
        X, candidates, groups, forces, earlier
            As in `predict_many`.
        """
        inputs = checked_columns(X, self.input_names, "X")
        totals = [self._total(values) for values in candidates]
        found, times = self._begun(inputs, totals, groups, forces, earlier)
        for kind, which in self._by_memory(totals):
            if kind:
                some = [totals[index] for index in which]
                self._carry_along(self._true(inputs, some), some, found.under(which), times)
        return found

    def _begun(
        self,
        inputs: Array,
        totals: Sequence[Mapping[str, float]],
        groups: ArrayLike | None,
        forces: Array | None,
        earlier: Array | None,
    ) -> tuple["Past", NDArray[np.intp]]:
        """Return the past of rows as if each were an episode's first but for commands, and the time of each."""
        starts = episode_starts(groups, len(inputs))
        physical = [self._physical(one) for one in totals]
        if earlier is None:
            acting = self._acting(self._actions(inputs), starts, physical)
        else:
            actions, firsts, own = with_earlier(self._actions(inputs), starts, earlier)
            acting = [
                None if one is None else tuple(part[own] for part in one)
                for one in self._acting(actions, firsts, physical)
            ]
        begun = self._steady(totals, len(inputs), acting)
        return replace(begun, forces=forces), np.arange(len(inputs)) - starts

    def _steady(
        self, totals: Sequence[Mapping[str, float]], n_rows: int, acting: Sequence[Acting] = ()
    ) -> "Past":
        """Return the past of rows whose hidden states are steady."""
        widths = [
            (len(self._own_hidden_names(self._physical(total))), len(self._lagging(total)))
            for total in totals
        ]
        hidden, ahead = (tuple(np.full((n_rows, one[k]), np.nan) for one in widths) for k in (0, 1))
        return Past(tuple(acting), hidden, ahead)

    def _by_memory(self, totals: Sequence[Mapping[str, float]]) -> Iterator[tuple[bool, NDArray[np.intp]]]:
        """Yield whether candidates have hidden states, and which do or do not."""
        n_hidden = np.array([self._n_hidden(total) for total in totals])
        for kind in np.unique(n_hidden > 0):
            yield bool(kind), np.flatnonzero((n_hidden > 0) == kind)

    def _true(self, inputs: Array, totals: Sequence[Mapping[str, float]]) -> Array:
        repeated = np.broadcast_to(inputs, (len(totals), *inputs.shape))
        return self._true_inputs(repeated, totals) if self.state_names else repeated

    def _carry_along(
        self, inputs: Array, totals: Sequence[Mapping[str, float]], past: "Past", times: NDArray[np.intp]
    ) -> Array:
        """Simulate rows, write what each leaves into the past of the next; return the outputs.

        Episodes are cut into pieces that run side by side, each begun in a steady state. What one leaves is carried
        into the next as far as it changes anything there: a memory that fades is soon the same whatever it began with.
        """
        outputs = np.empty((*inputs.shape[:2], len(self.output_names)))
        length = -(-len(times) * len(totals) // PIECES)
        has_next, new = np.r_[np.diff(times) == 1, False], np.ones(len(times), dtype=bool)
        rows = np.flatnonzero(times % length == 0)
        while rows.size:
            now = past.of(rows)
            carried = _Carried(self, totals, now)
            outputs[:, rows] = carried.step(inputs[:, rows], now.acting, np.arange(len(rows)))
            new[rows] = False
            followed = np.flatnonzero(has_next[rows])
            rows, moved = rows[followed] + 1, np.zeros(len(followed), dtype=bool)
            for mine, left in ((past.hidden, carried.hidden), (past.ahead, carried.ahead)):
                for one, other in zip(mine, left):
                    moved |= _is_moved(one[rows], other[followed])
                    one[rows] = other[followed]
            rows = rows[moved | new[rows]]
        return outputs

    def rollout(
        self,
        initial_states: ArrayLike,
        inputs: ArrayLike | None = None,
        *,
        n_steps: int,
        effects: Mapping[str, float] | None = None,
    ) -> Array:
        """Simulate whole episodes in open loop: each transition starts where the one before ended.

        Parameters
        ----------
        initial_states : array-like of shape (n_episodes, n_states)
        inputs : array-like of shape (n_episodes, n_steps, n_inputs - n_states), optional
            The inputs other than the state; None: zero.
        n_steps : int
            Number of transitions.
        effects : mapping from name to value, optional

        Returns
        -------
        ndarray of shape (n_episodes, n_steps + 1, n_outputs)
            The first states are the initial ones.

        Raises
        ------
        RuntimeError
            If an episode diverged.
        ValueError
            If the simulation is one-shot, or the arrays do not fit.
        """
        states: Array = self.rollout_many(initial_states, inputs, [effects or {}], n_steps=n_steps)[0]
        bad = np.any(~np.isfinite(states), axis=2)
        if bad.any():
            episode = int(np.flatnonzero(bad.any(axis=1))[0])
            raise RuntimeError(
                f"episode {episode} diverged at step {int(np.argmax(bad[episode]))} of {n_steps} with "
                f"effects "
                f"{dict(effects or {})}; check its inputs, take fewer steps, or a smaller time step"
            )
        return states

    def rollout_many(
        self,
        initial_states: ArrayLike,
        inputs: ArrayLike | None,
        candidates: Sequence[Mapping[str, float]],
        *,
        n_steps: int,
        before: ArrayLike | None = None,
        pushes: ArrayLike | None = None,
    ) -> Array:
        """Simulate whole episodes in open loop under each candidate set of effect values.

        Parameters
        ----------
        initial_states, inputs, n_steps
            As in `rollout`.
        candidates : sequence of mappings from name to value
        before : array-like of shape (n_episodes, n_before, n_inputs), optional
            Rows before the initial state, states included: commands that come late or through a filter, and hidden
            states, are what these rows leave. Without it, commands have held and hidden states are steady.
        pushes : array-like of shape (n_episodes, n_steps, n_residuals), optional
            By how much the state is displaced behind each step, as `displace` does.

        Returns
        -------
        ndarray of shape (n_candidates, n_episodes, n_steps + 1, n_outputs)
            NaN from where an episode diverged.
        """
        if not self.state_names:
            raise ValueError("a one-shot simulation has no state to roll out; use predict")
        start = checked_columns(initial_states, self.state_names, "initial_states")
        actions = self._checked_actions(inputs, len(start), n_steps)
        totals = [self._total(values) for values in candidates]
        n_states, n_episodes = len(self.state_names), len(start)
        earlier = np.zeros((n_episodes, 0, len(self.input_names)))
        if before is not None:
            earlier = np.asarray(before, dtype=float)
            checked_columns(earlier.reshape(-1, earlier.shape[-1]), self.input_names, "before")
        n_before = earlier.shape[1]
        n_rows = n_before + n_steps
        flat = np.concatenate([self._actions(earlier), actions], axis=1)
        flat = flat.reshape(n_episodes * n_rows, actions.shape[2])
        starts = np.repeat(np.arange(n_episodes) * n_rows, n_rows)
        acting = self._acting(flat, starts, [self._physical(total) for total in totals])
        by_step = [
            None if one is None else tuple(part.reshape(n_episodes, n_rows, *part.shape[1:]) for part in one)
            for one in acting
        ]
        carried = _Carried(self, totals, self._steady(totals, n_episodes))
        for step in range(n_before):
            rows = np.broadcast_to(earlier[:, step], (len(totals), *earlier[:, step].shape))
            now = [None if one is None else tuple(part[:, step] for part in one) for one in by_step]
            carried.step(self._true_inputs(rows, totals), now, np.arange(n_episodes))
        states = np.empty((len(totals), n_episodes, n_steps + 1, n_states))
        rows = np.empty((len(totals), n_episodes, len(self.input_names)))
        rows[:, :, :n_states] = self._true_inputs(np.broadcast_to(start, (len(totals), *start.shape)), totals)
        states[:, :, 0] = rows[:, :, :n_states]
        lost = np.zeros(rows.shape[:2], dtype=bool)
        moved_shape = *lost.shape, len(self.residual_names)
        for step in range(n_steps):
            rows[:, :, n_states:] = actions[:, step]
            now = [
                None if one is None else tuple(part[:, n_before + step] for part in one) for one in by_step
            ]
            outputs = carried.step(rows, now, np.arange(n_episodes))
            if pushes is not None:
                outputs = self.displace(outputs, np.broadcast_to(np.asarray(pushes)[:, step], moved_shape))
            lost |= ~np.isfinite(outputs).all(axis=2)
            states[:, :, step + 1] = np.where(lost[:, :, None], np.nan, outputs)
            rows[:, :, :n_states] = np.where(lost[:, :, None], states[:, :, 0], outputs)
        measured = self._measured(states.reshape(len(totals), -1, n_states), totals).reshape(states.shape)
        measured[:, :, 0] = start
        return measured

    def residual(self, y: ArrayLike, prediction: ArrayLike) -> Array:
        """Return the difference "y minus prediction", with a rotation vector for a quaternion.

        Parameters
        ----------
        y, prediction : array-like of shape (..., n_outputs)

        Returns
        -------
        ndarray of shape (..., n_residuals)
        """
        return np.subtract(y, prediction, dtype=float)

    def displace(self, X: ArrayLike, tangent: ArrayLike) -> Array:
        """Return the rows of inputs with their state moved by a residual-like displacement.

        Parameters
        ----------
        X : array-like of shape (..., n_inputs)
            Or states only, of shape (..., n_states).
        tangent : array-like of shape (..., n_residuals)

        Returns
        -------
        ndarray of the shape of X
            For states: ``residual(displace(state, d), state)`` is ``d``.
        """
        if not self.state_names:
            raise ValueError("a one-shot simulation has no state to displace")
        moved = np.array(
            np.broadcast_to(X, np.broadcast_shapes(np.shape(X), (*np.shape(tangent)[:-1], 1))), float
        )
        moved[..., : len(self.state_names)] += np.asarray(tangent, dtype=float)
        return moved

    def extended(self, effects: Mapping[str, float]) -> Self:
        """Return a new simulator with these effects built in, on top of those that are built in already.

        Values of the same effect combine: factors multiply, other values add.
        """
        parameters = self.get_params(deep=False)
        parameters["built_in"] = self._total(effects) or None
        return type(self)(**parameters)

    def set_params(self, **params: Any) -> Self:
        """Set constructor parameters by name, all of them or, where the simulator cannot be made so, none."""
        known = self.get_params(deep=False)
        unknown = sorted(set(params) - set(known))
        if unknown:
            raise ValueError(f"unknown parameters {', '.join(unknown)}; valid: {', '.join(known)}")
        self.__dict__ = type(self)(**(known | params)).__dict__
        return self

    def _lags(self, values: Mapping[str, float]) -> int:
        """Return how many rows back the inputs act on a row."""
        return 0

    @abstractmethod
    def _own_effects(self) -> tuple[Effect, ...]:
        """Return the effects other than those of sensors, whether or not some are built in."""

    @abstractmethod
    def _outputs(
        self,
        inputs: Array,
        candidates: Sequence[Mapping[str, float]],
        acting: Sequence[Acting],
        hidden: Sequence[Array] | None,
        forces: Array | None = None,
    ) -> tuple[Array, list[Array]]:
        """Return the outputs of each row of each candidate, NaN where the simulation diverged, and the hidden states.

        Parameters
        ----------
        inputs : ndarray of shape (n_candidates, n_rows, n_inputs)
            Possibly a read-only view that repeats the same rows.
        candidates : sequence of mappings
            Values of the own effects, those built in included.
        acting : sequence of tuples of arrays, or None
            For each candidate these rows of what `_acting` returned.
        hidden : sequence of ndarrays of shape (n_rows, n_hidden), or None
            For each candidate the hidden states as the rows begin, NaN for steady states. None: all are steady.
        forces : ndarray of shape (n_rows, n_forces), optional
            What acts on joints besides, in the order of `joint_forces`.
        """

    def _courses(
        self,
        inputs: Array,
        candidates: Sequence[Mapping[str, float]],
        acting: Sequence[Acting],
        hidden: Sequence[Array] | None,
        forces: Array | None = None,
    ) -> tuple[Array, list[Array], list[Courses]]:
        """Return what `_outputs` does, and how each candidate's state changes within the rows.

        A course, (n_parts, n_rows, n_states), holds the states at the ends of equal parts of the rows' time. Where the
        outputs are between those of two simulations, both are there, the second with its share.
        """
        outputs, after = self._outputs(inputs, candidates, acting, hidden, forces)
        return outputs, after, [[(1.0, one[None].copy())] for one in outputs]

    def _acting(
        self, actions: Array, starts: NDArray[np.intp], candidates: Sequence[Mapping[str, float]]
    ) -> list[Acting]:
        """Return what acts in each row of the inputs other than the state, a delay or a filter being in between.

        Parameters
        ----------
        actions : ndarray of shape (n_rows, n_actions)
        starts : ndarray of shape (n_rows,)
            First row of each row's episode.
        candidates : sequence of mappings
            Values of the own effects.

        Returns
        -------
        list
            For each candidate a tuple of arrays, each with an entry a row; None where the rows' own actions act.
        """
        return [None] * len(candidates)

    def _own_hidden_names(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """Return the names of the hidden states under these values, without those of sensors."""
        return ()

    def _n_hidden(self, total: Mapping[str, float]) -> int:
        return len(self._own_hidden_names(self._physical(total))) + len(self._lagging(total))

    def _lagging(self, total: Mapping[str, float]) -> dict[int, float]:
        """Return the time constant of each channel, by its column, that a filter delays."""
        columns = {f"lag[{name}]": index for index, name in enumerate(self.state_names)}
        return {columns[name]: value for name, value in total.items() if name in columns and value}

    def _physical(self, total: Mapping[str, float]) -> dict[str, float]:
        """Return the values of all effects but those of sensors."""
        sensors = self._cached(
            "sensor_names", lambda: frozenset(effect.name for effect in self._sensor_effects())
        )
        return {name: value for name, value in total.items() if name not in sensors}

    def _asked_effects(self) -> frozenset[str]:
        """Return the names of effects that are listed only when asked for."""
        return frozenset(effect.name for effect in self._sensor_effects() if effect.family == "lag")

    def _sensor_effects(self) -> tuple[Effect, ...]:
        channels = self.state_names or self.output_names
        units = {name: self.units.get(name, f"unit of {name}") for name in channels}
        limits = {name: HALF_TURNS.get(unit, UNBOUNDED) for name, unit in units.items()}
        return (
            *(
                Effect(f"bias[{name}]", unit=units[name], neutral=0.0, bounds=(-limits[name], limits[name]))
                for name in channels
            ),
            *(Effect(f"scale[{name}]", unit="1", neutral=1.0, bounds=(0.1, 10.0)) for name in channels),
            *sensor_lags(self.state_names, self.dt),
        )

    def _unlisted_effects(self) -> frozenset[str]:
        """Return the names of effects that are accepted, but are no causes to choose from."""
        return frozenset()

    @property
    def _all_by_name(self) -> dict[str, Effect]:
        """Every effect, its bounds relative to the model without the built-in ones."""
        every = (*self._own_effects(), *self._sensor_effects())
        return self._cached("all_by_name", lambda: {effect.name: effect for effect in every})

    @property
    def _by_name(self) -> dict[str, Effect]:
        """Every effect, its bounds relative to this simulator."""
        built_in = self._built_in()
        return self._cached(
            "by_name",
            lambda: {
                name: _rebased(effect, built_in.get(name)) for name, effect in self._all_by_name.items()
            },
        )

    def _built_in(self) -> dict[str, float]:
        return checked_values(self._all_by_name.values(), self.built_in) if self.built_in else {}

    def _total(self, values: Mapping[str, float] | None) -> dict[str, float]:
        """Return the given values with the built-in ones, in the effects' order, without neutral ones."""
        total = self._built_in()
        for name, value in checked_values(self._by_name.values(), values).items():
            total[name] = self._by_name[name].combined(total[name], value) if name in total else value
        every = self._all_by_name
        return {name: total[name] for name in every if name in total and total[name] != every[name].neutral}

    def _cached(self, key: Any, make: Callable[[], Made]) -> Made:
        """Return what was made before under this key; nothing of it is pickled or copied."""
        memory: dict[Any, Made] = self.__dict__.setdefault("_memory", {})
        if key not in memory:
            memory[key] = make()
        return memory[key]

    def __setattr__(self, name: str, value: Any) -> None:
        self.__dict__.pop("_memory", None)
        super().__setattr__(name, value)

    def __getstate__(self) -> dict[str, Any]:
        state = dict(super().__getstate__())
        state.pop("_memory", None)
        return state

    def _actions(self, inputs: Array) -> Array:
        return inputs[..., len(self.state_names) :]

    def _true_inputs(self, inputs: Array, totals: Sequence[Mapping[str, float]]) -> Array:
        """Return the true states behind measured ones: (measured - bias) / scale."""
        if not any(is_sensor(name) for total in totals for name in total):
            return inputs
        columns = {name: index for index, name in enumerate(self.state_names)}
        true = np.array(inputs)
        for rows, total in zip(true, totals):
            for channel, (scale, bias) in _sensors(total).items():
                rows[:, columns[channel]] = (rows[:, columns[channel]] - bias) / scale
        return true

    def _measured(self, outputs: Array, totals: Sequence[Mapping[str, float]]) -> Array:
        """Return what the sensors read of true outputs: scale * true + bias."""
        columns = {name: index for index, name in enumerate(self.state_names or self.output_names)}
        for rows, total in zip(outputs, totals):
            for channel, (scale, bias) in _sensors(total).items():
                rows[:, columns[channel]] = scale * rows[:, columns[channel]] + bias
        return outputs

    def _checked_actions(self, inputs: ArrayLike | None, n_episodes: int, n_steps: int) -> Array:
        names = self.input_names[len(self.state_names) :]
        expected = (n_episodes, n_steps, len(names))
        if isinstance(n_steps, bool) or int(n_steps) != n_steps or n_steps < 1:
            raise ValueError(f"n_steps must be a positive whole number; got {n_steps!r}")
        if inputs is None:
            return np.zeros(expected)
        actions = np.asarray(inputs, dtype=float)
        if actions.shape != expected:
            raise ValueError(
                f"inputs must have the shape (n_episodes, n_steps, n_inputs - n_states) = {expected}, "
                f"with the columns "
                f"{', '.join(names) or 'none'}; got {actions.shape}"
            )
        if not np.isfinite(actions).all():
            episode, step, column = np.argwhere(~np.isfinite(actions))[0]
            raise ValueError(
                f"inputs holds a value that is not finite: episode {episode}, step {step}, {names[column]}"
            )
        return actions


def sensor_lags(channels: Sequence[str], dt: float | None) -> Iterator[Effect]:
    """Yield the lag of each channel's sensor; a filter has a time only where transitions have."""
    for name in channels if dt else ():
        bounds = (0.0, LONGEST_LAG * dt)  # type: ignore[operator]
        yield Effect(f"lag[{name}]", unit="s", neutral=0.0, bounds=bounds, typical=dt)  # type: ignore[arg-type]


def is_sensor(name: str) -> bool:
    """Whether an effect of this name acts on what a sensor reads."""
    return name.startswith(("bias[", "scale[")) and not name.partition("[")[2].startswith("ctrl.")


@dataclass(frozen=True)
class Past:
    """What rows have of the rows before them, an entry for each candidate.

    Attributes
    ----------
    acting : tuple of None or tuple of ndarray of shape (n_rows, n_substeps, n_actions)
        What acts of the commands in each substep; None: those of the row.
    hidden : tuple of ndarray of shape (n_rows, n_hidden)
        States that the rows do not hold, as each begins; NaN: steady.
    ahead : tuple of ndarray of shape (n_rows, n_lagging)
        By how much the truth is ahead of what a sensor's filter shows; NaN: steady.
    forces : ndarray of shape (n_rows, n_forces), optional
        What acts on joints besides, under each candidate, in the order of `Simulator.joint_forces`.
    """

    acting: tuple["Acting", ...]
    hidden: tuple[Array, ...]
    ahead: tuple[Array, ...]
    forces: Array | None = None

    def of(self, rows: NDArray[np.intp]) -> "Past":
        """Return that of some rows, in their order; a row may be there more than once."""
        acting = tuple(None if one is None else tuple(part[rows] for part in one) for one in self.acting)
        hidden, ahead = (tuple(one[rows] for one in part) for part in (self.hidden, self.ahead))
        return Past(acting, hidden, ahead, None if self.forces is None else self.forces[rows])

    def under(self, candidates: Sequence[int] | NDArray[np.intp]) -> "Past":
        """Return that under some candidates, in their order."""
        acting, hidden = [self.acting[one] for one in candidates], [self.hidden[one] for one in candidates]
        return Past(tuple(acting), tuple(hidden), tuple(self.ahead[one] for one in candidates), self.forces)


def _is_moved(before: Array, after: Array) -> NDArray[np.bool_]:
    """Return in which rows (n_rows, n_hidden) a state is another one, by more than rounding of the largest is."""
    largest = np.abs(after).max(axis=0, initial=0.0, where=np.isfinite(after))
    same = np.isclose(after, before, rtol=0.0, atol=SAME * largest, equal_nan=True)
    return np.asarray(~same.all(axis=1))


class _Carried:
    """The hidden states of candidates, an entry for each episode, carried from row to row.

    A sensor's filter hides how far the truth is ahead of what it reads.
    """

    def __init__(self, simulator: Simulator, totals: Sequence[Mapping[str, float]], begin: Past):
        self._simulator = simulator
        self._physical = [simulator._physical(total) for total in totals]
        self._lagging = [simulator._lagging(total) for total in totals]
        self.hidden, self.ahead = ([one.copy() for one in part] for part in (begin.hidden, begin.ahead))
        self._forces = begin.forces

    def step(self, inputs: Array, acting: Sequence[Acting], episodes: NDArray[np.intp]) -> Array:
        """Return the outputs of one row of each of these episodes, as sensors without a bias read them."""
        simulator, dt = self._simulator, float(self._simulator.dt or math.nan)
        before = [hidden[episodes] for hidden in self.hidden]
        forces = None if self._forces is None else self._forces[episodes]
        if not any(self._lagging):
            outputs, after = simulator._outputs(inputs, self._physical, acting, before, forces)
        else:
            read, true = inputs, np.array(inputs)
            ahead = [one[episodes] for one in self.ahead]
            if any(np.isnan(one).any() for one in ahead):
                # A steady state: the filter lags what moves at a constant speed by its time constant.
                ended = simulator._outputs(true, self._physical, acting, before, forces)[0]
                for index, lags in enumerate(self._lagging):
                    for place, (column, lag) in enumerate(lags.items()):
                        steady = np.nan_to_num(ended[index, :, column] - read[index, :, column]) * lag / dt
                        known = ahead[index][:, place]
                        ahead[index][:, place] = np.where(np.isnan(known), steady, known)
            for index, lags in enumerate(self._lagging):
                true[index][:, list(lags)] += ahead[index]
            outputs, after, courses = simulator._courses(true, self._physical, acting, before, forces)
            for index, lags in enumerate(self._lagging):
                if lags:
                    columns, times = list(lags), np.array(list(lags.values()))
                    now = _behind(true[index][:, columns], courses[index], columns, ahead[index], times, dt)
                    self.ahead[index][episodes] = np.nan_to_num(now)
                    outputs[index][:, columns] -= now
        for kept, one in zip(self.hidden, after):
            kept[episodes] = one
        return outputs


def _behind(
    start: Array, courses: Courses, columns: list[int], ahead: Array, lags: Array, dt: float
) -> Array:
    """Return by how much the truth is ahead of filters of first order as a row ends; ``ahead`` is as it begins.

    Their input goes straight from the end of one part of a course to that of the next.
    """
    mixed = np.zeros_like(ahead)
    for share, course in courses:
        behind, before, part = ahead, start, dt / len(course)
        left = np.exp(-part / lags)
        for state in course:
            behind = lags * (state[:, columns] - before) / part * (1 - left) + behind * left
            before = state[:, columns]
        mixed += share * (behind - mixed)
    return mixed


def _sensors(total: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Return (scale, bias) of each channel that has one."""
    channels = {name.partition("[")[2][:-1] for name in total if is_sensor(name)}
    return {name: (total.get(f"scale[{name}]", 1.0), total.get(f"bias[{name}]", 0.0)) for name in channels}


def _rebased(effect: Effect, built_in: float | None) -> Effect:
    """Return the effect relative to a value that is built in; of a quantity stated in full that is the model's own."""
    if built_in is None or built_in == effect.neutral:
        return effect
    low, high = effect.bounds
    if effect.neutral == 0:
        return replace(effect, bounds=(low - built_in, high - built_in))
    if not effect.is_factor:
        return replace(effect, neutral=built_in)
    if built_in == 0:
        return effect
    ends = sorted((low / built_in, high / built_in))
    return replace(effect, bounds=(min(ends[0], 1.0), max(ends[1], 1.0)))
