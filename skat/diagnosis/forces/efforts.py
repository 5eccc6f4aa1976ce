r"""The causes that measured efforts ask for, given the motion that they went with.

Where a log holds what motors were measured to exert, and not what they were told, a controller faster than its rows has
answered to all that brakes a joint before the row was over. The motion is smoother than forces as rough as these
efforts would leave it, and of a motion given its efforts motors that do nothing are the likeliest. What such a log
measures is the efforts given the motion [1]_. Of a joint whose motor has the gain g, they lack

.. math:: \frac{1}{g} \left(M a + c + D v + F_c \operatorname{sign} v + \ldots\right) - u,

which is linear in friction, damping, rotor inertia and masses, and in 1 / g. Friction is Coulomb's here, as no model's
softness hides what a motor was measured to exert against it.

References
----------
.. [1] Swevers, Verdonck, De Schutter (2007). Dynamic model identification for industrial robots. IEEE Control Syst.
   Mag. 27(5).
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import mujoco
import numpy as np

from skat.diagnosis.causes import REFITTED, TURNS, proposals, readable, typical_biases
from skat.diagnosis.chains import Array, Mask
from skat.diagnosis.evidence import Gram, Priors, Weighed, Weigher, coarsened, weigh
from skat.diagnosis.fits import FIT_TURNS, STANDS_STILL, Fit, Fits
from skat.diagnosis.fitting import (
    NOTHING_KNOWN,
    Columns,
    Known,
    coordinate,
    first_fit,
    on_logarithm,
    priors_of,
)
from skat.diagnosis.forces.force_space import Motion, Rows, noise_beside
from skat.diagnosis.forces.left import left_of_efforts
from skat.diagnosis.forces.machines import UNSEEN, WEAKEST, Model
from skat.diagnosis.forces.motions import (
    STEP,
    Log,
    coefficients_of,
    lacking_forces,
    motion_of,
    shares_of,
    units_by,
)
from skat.diagnosis.found import Found, also_seen, told
from skat.diagnosis.noise import TOLERANCE
from skat.diagnosis.remainder import Remainder
from skat.diagnosis.search import Ranked, families_of, rivals_of, search
from skat.diagnosis.statespace import StateSpace
from skat.effects import Effect
from skat.simulators import MujocoSimulator, Simulator

# Families of which efforts tell nothing: when they were read is not known to a row.
UNTOLD = (*(family for family in UNSEEN if family != "payload"), "delay")
# Rows by which commands come late: an effort that was measured is that of the instant in which a row begins; in a row
# acts the mean of it and the next.
AT_INSTANT = -0.5


@dataclass(frozen=True)
class Regression:
    """Missing efforts of a log as rows that are linear in effects, about any machine.

    Attributes
    ----------
    simulator : MujocoSimulator
    half : Motion
        The log's motion.
    effects : tuple of Effect
    sizes : ndarray of shape (n_effects,)
        Typical ones, each in its effect's unit: the units of columns and values.
    driven : mapping from name to ndarray of bool of shape (nv,)
        Of each gain, the degrees of freedom on which its motors act.
    """

    simulator: MujocoSimulator
    half: Motion
    effects: tuple[Effect, ...]
    sizes: Array
    driven: Mapping[str, Mask]

    @classmethod
    def of(
        cls, simulator: MujocoSimulator, log: Log, effects: Sequence[Effect], typical: Mapping[str, float]
    ) -> "Regression":
        """Return the regression of a log; raises a ValueError where forces on joints cannot be told."""
        try:
            half = motion_of(simulator, log, "", measured=True)
        except ValueError as error:
            raise ValueError(
                f"{error} Or pass actions='commanded', if motors were told these efforts."
            ) from None
        gains = [effect for effect in effects if effect.family == "gain"]
        forces = lacking_forces(simulator, half, [Model({}), *(Model({one.name: 1 + STEP}) for one in gains)])
        nv = len(half.slip)
        driven = {
            one.name: np.any(moved[:, :nv] != forces[0, :, :nv], axis=0)
            for one, moved in zip(gains, forces[1:])
        }
        sizes = priors_of(effects, typical, logarithmic=False).scales
        regression = cls(simulator, half, tuple(effects), sizes, driven)
        rows = regression.about({}, 0.0)
        units = units_by(shares_of(rows)[:-1], effects, typical)
        return replace(regression, sizes=sizes * units)

    def priors(self) -> Priors:
        """Return the priors of values in units of sizes."""
        names = [effect.name for effect in self.effects]
        priors = priors_of(self.effects, dict(zip(names, self.sizes)), logarithmic=False)
        ends = np.array([_reach(effect) for effect in self.effects]) / self.sizes[:, None]
        return replace(priors, scales=np.ones(len(names)), low=ends[:, 0], high=ends[:, 1])

    def values(self, members: Sequence[int], places: Array) -> dict[str, float]:
        """Return the values, in the effects' units, of some effects at places in units of sizes."""
        effects = [self.effects[one] for one in members]
        return {
            effect.name: _value(effect, place * size)
            for effect, place, size in zip(effects, places, self.sizes[list(members)])
        }

    def about(self, values: Mapping[str, float], late: float) -> Rows:
        """Return rows that are linear about a machine, extrapolated to where every effect is neutral.

        The machine has no dry friction: Coulomb's law is linear in it, and MuJoCo's is softer the larger it is. The
        last column is of by how many rows efforts were read early, ``late`` in the machine.
        """
        machine = Model(
            {name: one for name, one in values.items() if not name.startswith("dry_friction[")},
            AT_INSTANT + late,
        )
        models, steps = [machine, Model({}, AT_INSTANT)], []
        for effect, size in zip(self.effects, self.sizes):
            here = _place(effect, machine.values.get(effect.name, effect.neutral))
            low, high = _reach(effect)
            step = min(STEP * size, (high - low) / 2)
            step = step if here + step <= high else -step
            models.append(
                replace(machine, values={**machine.values, effect.name: _value(effect, here + step)})
            )
            steps.append(step / size)
        models.append(replace(machine, late=machine.late + STEP))
        lacking = self._lacking(models)
        columns = (lacking[0] - lacking[2:]) / np.array([*steps, STEP])[:, None, None]
        coefficients, joint, frequency, stretch = coefficients_of(
            self.half, np.concatenate([lacking[:2], columns])
        )
        target, nominal, columns = coefficients[:, 0], coefficients[:, 1], coefficients[:, 2:]
        away = [
            _place(effect, machine.values.get(effect.name, effect.neutral)) / size
            for effect, size in zip(self.effects, self.sizes)
        ]
        return Rows(target + columns @ np.array([*away, late]), columns, joint, frequency, stretch, nominal)

    def _lacking(self, models: Sequence[Model]) -> Array:
        """Return by how much efforts lack, over each motor's gain, and measured speeds differ, (n, n_blocks, 2 nv)."""
        lacking = lacking_forces(self.simulator, self.half, models)
        for one, model in zip(lacking, models):
            for name, dofs in self.driven.items():
                one[:, np.flatnonzero(dofs)] /= model.values.get(name, 1.0)
        return lacking


def _place(effect: Effect, value: float) -> float:
    """Return how far a value is from neutral where efforts are linear in it: of a gain, by its inverse."""
    return 1 / value - 1 if effect.family == "gain" else value - effect.neutral


def _value(effect: Effect, place: float) -> float:
    """Return the value at a place, within bounds."""
    value = effect.neutral + place
    if effect.family == "gain":
        value = 1 / np.copysign(max(abs(1 + place), 1 / effect.bounds[1]), 1 + place)
    return float(np.clip(value, *effect.bounds))


def _slope(effect: Effect, value: float) -> float:
    """Return by how much the place of a value changes with its coordinate in the search of causes."""
    if effect.family == "gain":
        return -1 / value if on_logarithm(effect) else -1 / value**2
    return value if on_logarithm(effect) else 1.0


def _reach(effect: Effect) -> tuple[float, float]:
    """Return how far from neutral an effect may be; a motor's gain far below what it is taken for is none."""
    low, high = effect.bounds
    if effect.family == "gain":
        return -1 - 1 / WEAKEST, 1 / WEAKEST - 1
    if effect.is_factor:
        low = max(low, WEAKEST)
    return low - effect.neutral, high - effect.neutral


@dataclass(frozen=True)
class SetFit:
    """A set of causes at values and a noise of its own.

    Attributes
    ----------
    members : tuple of int
        Places of the effects, ascending.
    at : ndarray of shape (len(members),)
        Where efforts are linear, in units of sizes.
    late : float
        By how many rows efforts were read early.
    rows : Rows
        Linear about these values.
    noise : ndarray of shape (n_rows,)
    gram : Gram
        Of all effects from neutral at the set's noise, scores trusted as far as stretches of time agree on them.
    evidence : float
        Log evidence of the set, beside what all sets have in common, nats.
    """

    members: tuple[int, ...]
    at: Array
    late: float
    rows: Rows
    noise: Array
    gram: Gram
    evidence: float


@dataclass(frozen=True)
class Answer:
    """The causes that measured efforts ask for, and what is left of the efforts beside them."""

    found: Found
    remainder: Remainder


def causes_of_efforts(
    space: StateSpace,
    log: Log,
    effects: Sequence[Effect],
    *,
    alpha: float = 0.01,
    typical: Mapping[str, float] | None = None,
    known: Known = NOTHING_KNOWN,
    max_effects: int | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Answer:
    """Search for the set of causes that measured efforts ask for.

    Parameters
    ----------
    space : StateSpace
        Of the same log, for the noise of its sensors.
    log : tuple of (X, y, groups)
        NaN in states where nothing was measured.
    effects : sequence of Effect
        That may be causes; those that efforts do not tell are left out.
    alpha, typical, known, max_effects, progress
        As in `find_causes`.

    Returns
    -------
    Answer

    Raises
    ------
    ValueError
        If the simulator is none of joints that motors drive by a force, forces on its joints cannot be told, or efforts
        tell of no effect.
    """
    simulator = _of_motors(space.simulator)
    asked = ", ".join(one.name for one in effects)
    effects = [one for one in readable(space, effects) if one.family not in UNTOLD]
    if not effects:
        raise ValueError(
            f"measured efforts tell nothing of {asked}: ask about masses, friction, damping, rotors or gains, or pass "
            "actions='commanded'."
        )
    typical = {**typical_biases(space, effects), **(typical or {})}
    regression = Regression.of(simulator, log, effects, typical)
    power = coarsened(len(space.X))
    question = _Question(regression, regression.priors(), power, -float(np.log(alpha)), max_effects)
    now, stands = question.searched(progress)
    values = regression.values(now.members, now.at)
    fits = Fits(space, tuple(effects), priors_of(effects, typical), known, power)
    fitted = first_fit(space, values, known)
    gram = _in_coordinates(now.gram, regression, values)
    exclusive = rivals_of(effects)
    ask = partial(search, families=families_of(effects), most=max_effects)
    worth = Weigher(gram, fits.priors, exclusive, power=power)
    # Sets that only Gram matrices put before the one that fits prefer are none that it could be.
    best = worth(now.members)
    ranked = Ranked(
        tuple(
            one
            for one in ask(worth, now.members).sets
            if one.evidence <= best.evidence or set(best.members) <= set(one.members)
        )
    )
    found = Fit(now.members, values, fitted, now.evidence, np.zeros(len(now.members)))
    also = also_seen(ask, gram, fits.priors, effects, exclusive, best, question.needed, ())
    left = now.rows.target - now.rows.columns[:, [*now.members, -1]] @ np.r_[now.at, now.late]
    return Answer(
        told(fits, found, worth, ranked, (), also, question.needed, stands),
        left_of_efforts(simulator, regression.half, now.rows, left, now.noise),
    )


@dataclass(frozen=True)
class _Question:
    """Which set is worth most, each at a noise of its own."""

    regression: Regression
    priors: Priors
    power: float
    needed: float
    most: int | None

    def searched(self, progress: Callable[[str, int, int], None] | None) -> tuple[SetFit, bool]:
        """Return the set that no other is preferred to, and whether the search came to rest."""
        now, banned = self.fit((), np.zeros(0)), set[int]()
        for turn in range(TURNS):
            if progress is not None:
                progress("search", turn, TURNS)
            # A cause that is not there yet is noise, unless all that effects explain is taken out of it.
            moved = self.better(now, self.dense(now), banned) or self.better(now, now.gram, banned)
            if moved is None:
                held = {one for one, at in zip(now.members, now.at) if self.priors.is_held(one, at)}
                if not held:
                    return now, True
                banned |= held
                rest = [place for place, one in enumerate(now.members) if one not in held]
                moved = self.fit([now.members[place] for place in rest], now.at[rest])
            now = moved
        return now, False

    def better(self, now: SetFit, gram: Gram, banned: Collection[int]) -> SetFit | None:
        """Return the best of the sets that are preferred to the present one, of those that Gram matrices propose."""
        worth = Weigher(gram, self.priors, rivals_of(self.regression.effects), power=self.power)
        families = families_of(self.regression.effects)
        ranked = search(worth, now.members, families=families, banned=sorted(banned), most=self.most)
        asked = [*proposals(ranked, worth, now.members, self.needed), *self._weaker(worth, now)]
        fits = [self.fit(one.members, one.values) for one in asked]
        gains = [
            one.evidence - now.evidence - self.needed * (len(one.members) - len(now.members)) for one in fits
        ]
        best = int(np.argmax(gains)) if gains else -1
        return fits[best] if gains and gains[best] > TOLERANCE else None

    def _weaker(self, worth: Weigher, now: SetFit) -> list[Weighed]:
        """Return the present set without each of what it hardly needs."""
        whole = worth(now.members)
        losses = worth.losses(whole)
        return [worth.without(whole, one) for one in sorted(losses, key=lambda one: losses[one])[:REFITTED]]

    def fit(self, members: Sequence[int], at: Array) -> SetFit:
        """Return the fit of a set from values that may be near."""
        members, at, late = tuple(members), np.asarray(at, dtype=float), 0.0
        # Rows are taken about its values anew until these stand still.
        for _ in range(FIT_TURNS):
            rows = self.regression.about(self.regression.values(members, at), late)
            noise = noise_beside(replace(rows, columns=rows.columns[:, [*members, -1]]))
            columns, timing = _columns(rows, noise)
            one = weigh(columns.gram, self.priors, members, power=self.power)
            late = float(timing.at - timing.slopes[list(members)] @ one.values)
            moved, at = np.abs(one.values - at), one.values
            if np.all(moved < STANDS_STILL * one.deviations):
                break
        level = timing.level - float(np.log(noise).sum() + 0.5 * np.sum(columns.whitened**2))
        moves = np.zeros(len(self.priors.names))
        moves[list(members)] = at
        gram = _trusted(columns, moves)
        return SetFit(members, at, late, rows, noise, gram, self.power * level + one.evidence)

    def dense(self, now: SetFit) -> Gram:
        """Return Gram matrices about a set's values at the noise that is left when all effects act."""
        columns, _ = _columns(now.rows, noise_beside(now.rows))
        return _trusted(columns, columns.dense(self.priors.scales))


@dataclass(frozen=True)
class _Timing:
    """By how many rows efforts were read early: ``at - slopes @ values``; and what that not known costs, nats."""

    at: float
    slopes: Array
    level: float


def _columns(rows: Rows, noise: Array) -> tuple[Columns, _Timing]:
    """Return whitened rows with when efforts were read integrated out, a normal law of one row."""
    target, columns = rows.whitened(noise)
    early = columns[:, -1]
    precision = 1 + float(early @ early)
    at, slopes = float(early @ target) / precision, early @ columns[:, :-1] / precision
    # The last row is the law of when: with it rows are as if nothing was integrated out.
    whitened = np.r_[target - early * at, -at]
    left = np.vstack([columns[:, :-1] - np.outer(early, slopes), -slopes])
    gram = Gram(left.T @ left, left.T @ whitened, np.zeros(left.shape[1]))
    stretch = np.r_[rows.stretch, rows.stretch[-1]]
    return Columns(gram, whitened, left, stretch), _Timing(at, slopes, -0.5 * np.log(precision))


def _trusted(columns: Columns, moves: Array) -> Gram:
    return columns.gram.scattered(columns.excess(columns.whitened - columns.columns @ moves))


def _in_coordinates(gram: Gram, regression: Regression, values: Mapping[str, float]) -> Gram:
    """Return Gram matrices in the coordinates of the search of causes, about the values."""
    at = [values.get(effect.name, effect.neutral) for effect in regression.effects]
    places = np.array([_place(effect, one) for effect, one in zip(regression.effects, at)]) / regression.sizes
    slopes = np.array([_slope(effect, one) for effect, one in zip(regression.effects, at)]) / regression.sizes
    origin = np.array([coordinate(effect, one) for effect, one in zip(regression.effects, at)])
    projections = (gram.projections - gram.products @ places) * slopes
    return Gram(gram.products * slopes * slopes[:, None], projections, origin)


def _of_motors(simulator: Simulator) -> MujocoSimulator:
    """Return a simulator whose actions may be measured efforts."""
    if not isinstance(simulator, MujocoSimulator):
        raise ValueError(
            "measured efforts are those of a machine's joints, of which a function knows nothing: the simulator must "
            f"be a MujocoSimulator where actions='measured'; it is {simulator!r}."
        )
    model = simulator.compiled()
    servos = model.actuator_biasprm[:, 1:3].any(axis=1) & (
        model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
    )
    if servos.any() or not model.nu:
        names = ", ".join(
            model.actuator(int(one)).name or f"actuator {one}" for one in np.flatnonzero(servos)
        )
        what = (
            f"{names} of this model are servos, which take targets" if names else "this model has no motors"
        )
        raise ValueError(
            f"actions='measured' is for what motors were measured to exert, and {what}: drive the joints by motors "
            "(of a URDF motors='torque', on the command line --motors torque), or pass actions='commanded'."
        )
    return simulator
