"""A simulator around any function."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skat.effects import Effect
from skat.simulators.base import LONGEST_LAG, Acting, Simulator, is_sensor, sensor_lags
from skat.simulators.commands import CommandPath
from skat.simulators.tables import Array

# Of a transition, over which the mean is taken of what arrives.
PIECES = 32


class FunctionSimulator(Simulator):
    """A simulator around ``function(X, **values) -> Y``.

    Parameters
    ----------
    function : callable
        ``function(X, **values)`` maps X of shape (n_rows, n_inputs) to Y of shape (n_rows, n_outputs).
        ``values`` holds every effect of ``effects`` by its name, as a float, neutral ones included; names
        that are no Python identifiers, such as ``"mass[arm]"``, arrive in ``**values``. Rows that are not
        finite count as diverged.
    input_names, output_names : sequence of str
        Names of columns.
    state_names : sequence of str, default=()
        Empty: a one-shot simulation. Otherwise the first inputs and the outputs, which must bear these names.
    effects : sequence of Effect, default=()
        What the function can take on. Effects of the sensors are added by themselves; with `dt`, so are a delay and a
        lag of first order of each input other than the state. As the function takes one value of an input for a whole
        transition, it is given the mean over the transition of what arrives.
    dt : float, optional
        Duration of a transition, s.
    units : mapping from name to str, optional
        Units of columns, such as ``{"angle": "rad", "rate": "rad/s"}``: findings have them, a sensor of an angle is
        off by half a turn at most, and a log whose angles look like degrees is warned of.
    built_in : mapping from name to value, optional
        Effects that are built in; see `extended`.

    Examples
    --------
    >>> import numpy as np
    >>> from skat.effects import Effect
    >>> from skat.simulators import FunctionSimulator
    >>> def fall(X, gravity):
    ...     return np.stack([X[:, 0] + 0.1 * X[:, 1], X[:, 1] - 0.1 * 9.81 * gravity], axis=1)
    >>> ball = FunctionSimulator(
    ...     fall, input_names=("height", "speed"), output_names=("height", "speed"),
    ...     state_names=("height", "speed"),
    ...     effects=(Effect("gravity", unit="1", neutral=1.0, bounds=(0.0, 3.0)),))
    >>> ball.predict([[2.0, 0.0]], effects={"gravity": 2.0})
    array([[ 2.   , -1.962]])
    """

    def __init__(
        self,
        function: Callable[..., Any],
        *,
        input_names: Sequence[str],
        output_names: Sequence[str],
        state_names: Sequence[str] = (),
        effects: Sequence[Effect] = (),
        dt: float | None = None,
        units: Mapping[str, str] | None = None,
        built_in: Mapping[str, float] | None = None,
    ):
        self.function = function
        self.input_names = tuple(input_names)
        self.output_names = tuple(output_names)
        self.state_names = tuple(state_names)
        self.dt = dt
        self._units = units  # as `effects`
        self.built_in = built_in
        self._effects = tuple(effects)  # `effects` is a method of every simulator
        _check_names(self.input_names, self.output_names, self.state_names)
        if dt is not None and not 0 < dt < math.inf:
            raise ValueError(f"dt must be positive and finite, in s, or None; got {dt!r}")
        _check_effects(self._effects, [effect.name for effect in sensor_lags(self.state_names, dt)])
        _check_units(self.units, (*self.input_names, *self.output_names))

    def __repr__(self) -> str:
        parts = [getattr(self.function, "__name__", repr(self.function))]
        parts.append(f"effects=[{', '.join(effect.name for effect in self._effects)}]")
        if self.built_in:
            parts.append(f"built_in={dict(self.built_in)}")
        return f"{type(self).__name__}({', '.join(parts)})"

    @property
    def units(self) -> Mapping[str, str]:
        """Units of columns by name, as given."""
        return self._units or {}

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the constructor's parameters by name."""
        names = ("function", "input_names", "output_names", "state_names", "dt", "built_in")
        return {
            **{name: getattr(self, name) for name in names},
            "effects": self._effects,
            "units": self._units,
        }

    def _own_effects(self) -> tuple[Effect, ...]:
        return (*self._effects, *self._late_effects())

    def _asked_effects(self) -> frozenset[str]:
        return super()._asked_effects() | {effect.name for effect in self._late_effects()}

    def _late_effects(self) -> tuple[Effect, ...]:
        """Return delays and lags of the inputs other than the state, but for those that the function has itself."""
        inputs = self.input_names[len(self.state_names) :]
        if not self.dt or not self.state_names or not inputs:
            return ()
        bounds, own = (0.0, LONGEST_LAG * self.dt), {effect.name for effect in self._effects}
        names = [f"lag[{name}]" for name in inputs] + [f"delay[{name}]" for name in inputs]
        names += ["delay[action]"] if "action" not in inputs else []
        return tuple(
            Effect(name, unit="s", neutral=0.0, bounds=bounds, typical=self.dt)
            for name in names
            if name not in own
        )

    def _path(self, values: Mapping[str, float]) -> CommandPath:
        """Return what lies between the inputs other than the state and the function, but for what it does itself."""
        own = {effect.name for effect in self._effects}
        values = {name: value for name, value in values.items() if name not in own}
        names = self.input_names[len(self.state_names) :]
        delay, lag = (
            np.array([values.get(f"{family}[{name}]", 0.0) for name in names]) for family in ("delay", "lag")
        )
        zeros = np.zeros(len(names))
        delay += values.get("delay[action]", 0.0)
        return CommandPath(1 + zeros, zeros, zeros, delay, lag, zeros)

    def _acting(
        self, actions: Array, starts: NDArray[np.intp], candidates: Sequence[Mapping[str, float]]
    ) -> list[Acting]:
        found: list[Acting] = []
        for values in candidates:
            path = self._path(values)
            within = path.acting(actions, starts, float(self.dt), PIECES) if path.changes else None  # type: ignore[arg-type]
            found.append(None if within is None else (within.mean(axis=1),))
        return found

    def _lags(self, values: Mapping[str, float]) -> int:
        return self._path(values).n_lags(self.dt, PIECES) if self.dt else 0

    def _outputs(
        self,
        inputs: Array,
        candidates: Sequence[Mapping[str, float]],
        acting: Sequence[Acting],
        hidden: Sequence[Array] | None,
        forces: Array | None = None,
    ) -> tuple[Array, list[Array]]:
        n_states = len(self.state_names)
        outputs = np.empty((*inputs.shape[:2], len(self.output_names)))
        for index, values in enumerate(candidates):
            complete = {effect.name: values.get(effect.name, effect.neutral) for effect in self._effects}
            rows, late = inputs[index].copy(), acting[index]
            if late is not None:
                rows[:, n_states:] = late[0]
            result = self._called(rows, complete)
            if result.shape != outputs.shape[1:]:
                raise ValueError(
                    f"the function must return the shape (n_rows, n_outputs) = {outputs.shape[1:]}, "
                    f"with the columns "
                    f"{', '.join(self.output_names)}; it returned {result.shape}"
                )
            result = np.where(np.isfinite(result).all(axis=1, keepdims=True), result, np.nan)
            outputs[index] = result
        return outputs, [np.zeros((inputs.shape[1], 0))] * len(candidates)

    def _called(self, inputs: Array, values: Mapping[str, float]) -> Array:
        try:
            result = np.asarray(self.function(inputs, **values))
        except Exception as error:
            effects = ", ".join(f"{name}={value:g}" for name, value in values.items()) or "no effects"
            error.add_note(
                f"The simulator's function raised this for {len(inputs)} rows and {effects}. Rows that it cannot "
                "simulate it may return as NaN: they count as diverged."
            )
            raise
        if np.iscomplexobj(result):
            raise TypeError(f"the function must return real numbers; it returned an array of {result.dtype}")
        return result.astype(float)


def _check_effects(effects: Sequence[Effect], lags: Collection[str]) -> None:
    for effect in effects:
        if not isinstance(effect, Effect):
            raise TypeError(
                "effects must be a sequence of skat.effects.Effect, such as "
                f"Effect('drag', unit='1/s', neutral=0.0, bounds=(0.0, 2.0)); got {effect!r}"
            )
        if is_sensor(effect.name) or effect.name in lags:
            raise ValueError(
                f"{effect.name} is no name for an effect of one's own: bias[...], scale[...] and, with dt, lag[...] "
                "of each measured channel are there already, and act on what its sensor reads. Choose another family"
            )
    names = [effect.name for effect in effects]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ValueError(f"effects must have different names; {', '.join(repeated)} occurs more than once")


def _check_units(units: Mapping[str, str], names: Sequence[str]) -> None:
    unknown = sorted(set(units) - set(names))
    if unknown:
        raise ValueError(
            f"units has names that no column bears: {', '.join(unknown)}; the columns are "
            f"{', '.join(dict.fromkeys(names))}"
        )


def _check_names(inputs: tuple[str, ...], outputs: tuple[str, ...], states: tuple[str, ...]) -> None:
    if not inputs or not outputs:
        raise ValueError(
            "a simulator needs at least one input and one output; input_names or output_names is empty"
        )
    for argument, names in (("input_names", inputs), ("output_names", outputs)):
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise ValueError(
                f"{argument} must differ from each other; {', '.join(repeated)} occurs more than once"
            )
    if states and (inputs[: len(states)] != states or outputs != states):
        raise ValueError(
            f"with state_names, the first inputs and the outputs must be the state {states}; got the "
            f"inputs {inputs} "
            f"and the outputs {outputs}"
        )
