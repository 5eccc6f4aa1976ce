"""What every simulator offers: rows of inputs in, rows of outputs out, under any effects."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator

from skat.effects import Effect, checked_values
from skat.simulators.tables import Array, checked_columns, earlier_rows, episode_starts

# Of the bias of a sensor: half a turn, or nothing that a unit of one's own would say.
HALF_TURNS = {"rad": math.pi, "deg": 180.0}
UNBOUNDED = 1e12


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
    def angle_names(self) -> tuple[str, ...]:
        """Names of the state's columns that are angles or their rates, in rad or rad/s."""
        return tuple(name for name in self.state_names if self.units.get(name) in ("rad", "rad/s"))

    @property
    def command_limits(self) -> dict[str, tuple[float, float]]:
        """Range that the simulation clips an input to, by name of the input."""
        return {}

    def effects(self) -> tuple[Effect, ...]:
        """Return every effect that this simulator can take on and that no other effect listed repeats.

        The values of an effect are relative to this simulator: where an effect is built in already, its
        bounds are what is left of the original ones.
        """
        unlisted = self._unlisted_effects()
        return tuple(effect for effect in self._by_name.values() if effect.name not in unlisted)

    def joint_forces(self) -> tuple[tuple[Effect, tuple[str, ...]], ...]:
        """Return effects that are a force on one joint each, with the inputs of that joint; none unless overridden."""
        return ()

    def n_lags(self, effects: Mapping[str, float] | None = None) -> int:
        """Return of how many earlier rows the actions still act in a row: a delay, in transitions, rounded up."""
        return self._lags(self._total(effects))

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
            Episode of each row; an episode's rows are consecutive and in time order. Only ``delay[action]``
            needs it: the action of the row before acts for the first part of a transition, and an episode's
            first row has only its own. None: all rows are one episode.

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
        outputs = self.predict_many(X, [effects or {}], groups=groups)[0]
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
        self, X: ArrayLike, candidates: Sequence[Mapping[str, float]], *, groups: ArrayLike | None = None
    ) -> Array:
        """Simulate each row under each candidate set of effect values.

        Parameters
        ----------
        X : array-like of shape (n_rows, n_inputs)
        candidates : sequence of mappings from name to value
        groups : array-like of shape (n_rows,), optional
            As in `predict`.

        Returns
        -------
        ndarray of shape (n_candidates, n_rows, n_outputs)
            Rows whose simulation diverged are NaN.
        """
        inputs = checked_columns(X, self.input_names, "X")
        totals = [self._total(values) for values in candidates]
        n_lags = max([self._lags(values) for values in totals], default=0)
        starts = episode_starts(groups, len(inputs))
        history = earlier_rows(self._actions(inputs), starts, n_lags) if n_lags else None
        repeated = np.broadcast_to(inputs, (len(totals), *inputs.shape))
        if not totals or not len(inputs):
            return np.empty((len(totals), len(inputs), len(self.output_names)))
        if not self.state_names:
            return self._measured(
                self._outputs(repeated, [_physical(total) for total in totals], history), totals
            )
        inputs_true = self._true_inputs(repeated, totals)
        outputs = self._outputs(inputs_true, [_physical(total) for total in totals], history)
        return self._measured(outputs, totals)

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
        states = self.rollout_many(initial_states, inputs, [effects or {}], n_steps=n_steps)[0]
        bad = ~np.isfinite(states).all(axis=2)
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
    ) -> Array:
        """Simulate whole episodes in open loop under each candidate set of effect values.

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
        physical = [_physical(total) for total in totals]
        n_lags = max([self._lags(values) for values in totals], default=0)
        n_states = len(self.state_names)
        states = np.empty((len(totals), len(start), n_steps + 1, n_states))
        rows = np.empty((len(totals), len(start), len(self.input_names)))
        rows[:, :, :n_states] = self._true_inputs(np.broadcast_to(start, (len(totals), *start.shape)), totals)
        states[:, :, 0] = rows[:, :, :n_states]
        lost = np.zeros(rows.shape[:2], dtype=bool)
        for step in range(n_steps):
            rows[:, :, n_states:] = actions[:, step]
            history = None
            if n_lags:
                history = actions[:, [max(step - lag, 0) for lag in range(1, n_lags + 1)]]
            outputs = self._outputs(rows, physical, history)
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
        return np.asarray(y, dtype=float) - np.asarray(prediction, dtype=float)

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
        self._require_state("displace")
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

    @abstractmethod
    def _own_effects(self) -> tuple[Effect, ...]:
        """Return the effects other than those of sensors, whether or not some are built in."""

    @abstractmethod
    def _outputs(
        self, inputs: Array, candidates: Sequence[Mapping[str, float]], history: Array | None
    ) -> Array:
        """Return the outputs of each row of each candidate, NaN where the simulation diverged.

        Parameters
        ----------
        inputs : ndarray of shape (n_candidates, n_rows, n_inputs)
            Possibly a read-only view that repeats the same rows.
        candidates : sequence of mappings
            Values of the own effects, those built in included.
        history : ndarray of shape (n_rows, n_lags, n_actions), or None
            Inputs other than the state of the rows before: one row back, two rows back, ...
        """

    def _lags(self, values: Mapping[str, float]) -> int:
        """Return how many rows back the inputs act on a row."""
        return 0

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

    def _cached(self, key: Any, make: Callable[[], Any]) -> Any:
        """Return what was made before under this key; nothing of it is pickled or copied."""
        memory = self.__dict__.setdefault("_memory", {})
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

    def _require_state(self, action: str) -> None:
        if not self.state_names:
            raise ValueError(f"a one-shot simulation has no state to {action}")

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


def is_sensor(name: str) -> bool:
    """Whether an effect of this name acts on what a sensor reads."""
    return name.startswith(("bias[", "scale[")) and not name.partition("[")[2].startswith("ctrl.")


def _physical(total: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in total.items() if not is_sensor(name)}


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
