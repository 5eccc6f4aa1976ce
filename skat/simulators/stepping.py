"""Stepping many rows under many models at once, on MuJoCo's thread pool.

Each row starts from a clean state: its own positions, velocities and controls, time zero, no warm start of
the constraint solver and no applied forces. So the result of a row does not depend on other rows, on their
order, or on how they are cut into chunks.
"""

import copy
import functools
import multiprocessing
import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, Self

import joblib
import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch, SimulationError
from numpy.typing import NDArray

from skat.simulators.anatomy import INTEGRATOR, JOINT_TRANSMISSIONS
from skat.simulators.friction import LOADED, NEUTRAL, budget
from skat.simulators.tables import Array

CHUNK = 8192
# To wake a thread takes as long as so many steps of a small robot.
ROWS_OF_THREAD = 32
CACHED_BATCHES = 32
HUGE = 1e10  # MuJoCo's own limit of a state that is not divergent
MUSCLE = int(mujoco.mjtDyn.mjDYN_MUSCLE)
FILTERS = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT), MUSCLE)
LIMITS = ("actuator_ctrlrange", "actuator_ctrllimited", "actuator_forcerange", "actuator_forcelimited")
SERVOS = ("actuator_gainprm", "actuator_biasprm")

_left_to_other_processes: list[object] = []


@dataclass(frozen=True)
class Forces:
    """What acts on the rows of one candidate and no compiled model expresses.

    Attributes
    ----------
    body : int
        The body at whose centre of mass wind and drag act.
    wind : tuple of three floats
        Constant force, N, in the world frame.
    drag : tuple of three floats
        Drag coefficients c of -c |v_i| v_i along the world axes, kg/m.
    drag_all : float
        Drag coefficient c of -c |v| v, kg/m.
    joints : tuple of (dof, force)
        Constant generalised forces, N or N m.
    friction : tuple of (dof, column of qpos, coefficients)
        What `friction.budget` adds to the friction of a joint.
    dead_zones : tuple of (actuator, half of the width)
        Of servos without dynamics: of the difference of control and that at which there is no force.
    speed_slopes : tuple of (actuator, slope)
        Both ends of the model's range of force are less by slope * speed, but within this range.
    torque_lags : tuple of (actuator, time constant)
        The force follows what it should be through a filter of first order.
    """

    body: int = 0
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drag: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drag_all: float = 0.0
    joints: tuple[tuple[int, float], ...] = ()
    friction: tuple[tuple[int, int, tuple[float, ...]], ...] = ()
    dead_zones: tuple[tuple[int, float], ...] = ()
    speed_slopes: tuple[tuple[int, float], ...] = ()
    torque_lags: tuple[tuple[int, float], ...] = ()

    @property
    def has_drag(self) -> bool:
        """Whether the force depends on the velocity."""
        return any(self.drag) or self.drag_all != 0

    @property
    def kinds(self) -> frozenset[str]:
        """What needs to be renewed in each substep."""
        kinds = {"friction", "dead_zones", "speed_slopes", "torque_lags"}
        loaded = any(any(law[place] for place in LOADED) for *_, law in self.friction)
        found = {kind for kind in kinds if getattr(self, kind)}
        return frozenset(found | ({"drag"} if self.has_drag else set()) | ({"load"} if loaded else set()))

    @property
    def changes_within_transition(self) -> bool:
        """Whether each substep needs its own forces."""
        return bool(self.kinds)


@dataclass(frozen=True)
class Play:
    """A joint between a motor and its link, which the columns of the state know as one joint.

    Attributes
    ----------
    joint, joint_dof : int
        Column of qpos and of qvel of the motor's joint, in the model with all the plays.
    play, play_dof : int
        The same of the joint between motor and link.
    width : float
        rad or m.
    """

    joint: int
    joint_dof: int
    play: int
    play_dof: int
    width: float


@dataclass(frozen=True)
class Job:
    """Rows of one candidate to be stepped under one model.

    Attributes
    ----------
    candidate : int
        Where in the table of inputs its rows are.
    model : mujoco.MjModel
    n_substeps : int
    forces : Forces
    controls : ndarray of shape (n_rows, n_substeps, nu), optional
        Controls of each substep, where they change within a transition; otherwise those of the rows act.
    plays : tuple of Play
        In the order of their columns.
    hidden : ndarray of shape (n_rows, n_hidden), optional
        States that the rows do not hold: the model's activations, the torques that lag, then place and speed of each
        play. NaN stands for a steady state. None: all are steady.
    """

    candidate: int
    model: mujoco.MjModel
    n_substeps: int
    forces: Forces = field(default_factory=Forces)
    controls: Array | None = None
    plays: tuple[Play, ...] = ()
    hidden: Array | None = None

    @property
    def n_hidden(self) -> int:
        """Number of states that the rows do not hold."""
        return int(self.model.na) + len(self.forces.torque_lags) + 2 * len(self.plays)


@dataclass(frozen=True)
class Rest:
    """When a simulation that runs until it comes to rest is over.

    Attributes
    ----------
    reached : callable
        ``reached(qpos, qvel)`` maps states of shape (n, nq), (n, nv) to a mask of shape (n,).
    max_blocks : int
        How many times ``n_substeps`` to wait. Rows that do not come to rest by then count as diverged.
    """

    reached: Callable[[Array, Array], NDArray[np.bool_]]
    max_blocks: int


class Stepper:
    """Runs jobs; keeps MuJoCo's batches, and so the thread pool, for the next call."""

    def __init__(self) -> None:
        self._batches: OrderedDict[tuple[Any, ...], _Pool] = OrderedDict()
        self._lock = threading.Lock()
        self._process = os.getpid()

    def run(
        self, jobs: Sequence[Job], inputs: Array, forces: Array | None = None, *, rest: Rest | None = None
    ) -> tuple[Array, list[Array]]:
        """Return the states after each job, after its substeps or once they are at rest, and the hidden states.

        Parameters
        ----------
        jobs : sequence of Job
        inputs : ndarray of shape (n_candidates, n_rows, n_states + nu)
        forces : ndarray of shape (n_rows, nv), optional
            Applied to the degrees of freedom of each row, those of plays apart, under every candidate, N or N m.
        rest : Rest, optional
            Repeat the substeps until each row is at rest.

        Returns
        -------
        states : ndarray of shape (n_jobs, n_rows, n_states)
            NaN where the simulation diverged.
        hidden : list of n_jobs ndarrays of shape (n_rows, n_hidden)
            As `Job`'s.
        """
        n_rows, n_states = inputs.shape[1], inputs.shape[2] - jobs[0].model.nu
        states = np.empty((len(jobs), n_rows, n_states))
        hidden = [np.empty((n_rows, job.n_hidden)) for job in jobs]
        with self._lock, quiet():
            self._forget_batches_of_parent()
            for members in _alike(jobs):
                together = [jobs[index] for index in members]
                self._run_together(together, members, inputs, forces, states, hidden, rest)
        _mark_diverged(states)
        return states, hidden

    def courses(
        self, jobs: Sequence[Job], inputs: Array, forces: Array | None = None
    ) -> tuple[list[Array], list[Array]]:
        """Return the states after each substep of each job, (n_substeps, n_rows, n_states), and the hidden states.

        Parameters, and what diverges, as in `run`.
        """
        n_rows, n_states = inputs.shape[1], inputs.shape[2] - jobs[0].model.nu
        courses = [np.empty((job.n_substeps, n_rows, n_states)) for job in jobs]
        hidden = [np.empty((n_rows, job.n_hidden)) for job in jobs]
        with self._lock, quiet():
            self._forget_batches_of_parent()
            for members in _alike(jobs):
                together = [jobs[index] for index in members]
                for pool, which, row, controls, laws in self._loaded(together, inputs, n_rows, forces):
                    seen: list[Array] = []
                    pool.step(together[0].n_substeps, controls, laws, seen)
                    after = pool.hidden()
                    for job in np.unique(which):
                        mine = which == job
                        courses[members[job]][:, row[mine]] = np.stack(seen)[:, mine]
                        hidden[members[job]][row[mine]] = after[mine]
        for course in courses:
            _mark_diverged(course)
        return courses, hidden

    def missing_forces(self, jobs: Sequence[Job], inputs: Array, accelerations: Array) -> tuple[Array, Array]:
        """Return what a motion needs beyond what each job's model exerts, and the dry friction that it has.

        Parameters
        ----------
        jobs : sequence of Job
            Their models have no constraints, which no motion tells apart from what is missing.
        inputs : ndarray of shape (n_candidates, n_rows, n_states + nu)
        accelerations : ndarray of shape (n_rows, nv)

        Returns
        -------
        forces : ndarray of shape (n_jobs, n_rows, nv)
            M a - (what gravity, motion, springs, dampers, actuators and applied forces amount to), without dry
            friction, N or N m.
        friction : ndarray of shape (n_jobs, n_rows, nv)
            Size of each degree of freedom's dry friction.
        """
        n_rows = inputs.shape[1]
        forces, friction = np.empty((2, len(jobs), n_rows, jobs[0].model.nv))
        with self._lock, quiet():
            self._forget_batches_of_parent()
            for members in _alike(jobs):
                destinations = np.array(members)
                together = [jobs[index] for index in members]
                for pool, which, row, _, laws in self._loaded(together, inputs, n_rows):
                    place = destinations[which], row
                    forces[place], friction[place] = pool.missing_forces(accelerations[row], laws)
        return forces, friction

    def constrained(self, job: Job, inputs: Array) -> NDArray[np.bool_]:
        """Return in which rows (1, n_rows, n_states + nu) a constraint of the job's model exerts a force."""
        found = np.zeros(inputs.shape[1], dtype=bool)
        with self._lock, quiet():
            self._forget_batches_of_parent()
            for pool, _, row, _, _ in self._loaded([job], inputs, inputs.shape[1]):
                found[row] = pool.constrained()
        return found

    def _run_together(
        self,
        jobs: list[Job],
        slots: list[int],
        inputs: Array,
        forces: Array | None,
        states: Array,
        hidden: list[Array],
        rest: Rest | None,
    ) -> None:
        n_rows = states.shape[1]
        destinations = np.array(slots)
        for pool, which, row, controls, laws in self._loaded(jobs, inputs, n_rows, forces):
            if rest is not None:
                states[destinations[which], row] = pool.settle(jobs[0].n_substeps, rest, laws)
                continue
            pool.step(jobs[0].n_substeps, controls, laws)
            states[destinations[which], row] = pool.states()
            after = pool.hidden()
            for job in np.unique(which):
                hidden[slots[job]][row[which == job]] = after[which == job]

    def _loaded(
        self, jobs: list[Job], inputs: Array, n_rows: int, forces: Array | None = None
    ) -> Iterator[tuple[Any, ...]]:
        """Yield a pool with the next rows in it, the job and the row of each, controls of substeps, laws."""
        total, n_states = len(jobs) * n_rows, inputs.shape[2] - jobs[0].model.nu
        forced = jobs[0].forces.changes_within_transition
        pool = self._pool(jobs[0], min(total, CHUNK))
        candidates = np.array([job.candidate for job in jobs])
        winds = np.array([job.forces.wind for job in jobs])
        generalised = np.zeros((len(jobs), jobs[0].model.nv))
        laws = _Laws(jobs) if forced else None
        for own, job in zip(generalised, jobs):
            for dof, force in job.forces.joints:
                own[dof] = force
        plays = {play.play_dof for play in jobs[0].plays}
        seen = [dof for dof in range(jobs[0].model.nv) if dof not in plays]
        for start in range(0, total, CHUNK):
            flat = np.arange(start, min(start + CHUNK, total))
            which, row = np.divmod(flat, n_rows)
            source = inputs[candidates[which], row]
            pool.set_models([jobs[index].model for index in range(which[0], which[-1] + 1)], which - which[0])
            before = np.full((len(flat), jobs[0].n_hidden), np.nan)
            for job in np.unique(which):
                if jobs[job].hidden is not None:
                    before[which == job] = jobs[job].hidden[row[which == job]]
            controls = None
            if jobs[0].controls is not None:
                controls = np.stack([jobs[job].controls[index] for job, index in zip(which, row)])
            first = source[:, n_states:] if controls is None else controls[:, 0]
            widths = np.array([[play.width for play in jobs[job].plays] for job in which])
            pool.xfrc[: len(flat)] = 0
            pool.xfrc[: len(flat), jobs[0].forces.body, :3] = winds[which]
            pool.qfrc[: len(flat)] = generalised[which]
            if forces is not None:
                pool.qfrc[: len(flat), seen] += forces[row]
            pool.load(source[:, :n_states], first, before, jobs[0].plays, widths)
            yield pool, which, row, controls, None if laws is None else laws.of(which)

    def _pool(self, job: Job, size: int) -> "_Pool":
        """Return a cached batch of at least this size."""
        size = 1 << max(size - 1, 0).bit_length()
        forced = job.forces.changes_within_transition
        make = _ForcedPool if forced else _Pool
        flags = int(job.model.opt.disableflags)
        key = (make, size, flags, _sizes(job.model), _rigid_parts(job.model) if forced else None)
        if key not in self._batches:
            self._batches[key] = make(job.model, size)
            if len(self._batches) > CACHED_BATCHES:
                self._batches.popitem(last=False)
        self._batches.move_to_end(key)
        return self._batches[key]

    def _forget_batches_of_parent(self) -> None:
        """After a fork the threads of inherited batches do not exist; closing them would wait forever."""
        if self._process != os.getpid():
            _left_to_other_processes.append(self._batches)
            self._batches, self._process = OrderedDict(), os.getpid()


class _Laws:
    """What jobs that run together need in each substep, an entry a job."""

    def __init__(self, jobs: list[Job]):
        forces = [job.forces for job in jobs]
        self.kinds, self.body = forces[0].kinds, forces[0].body
        self.wind = np.array([one.wind for one in forces])
        self.drag = np.array([one.drag for one in forces])
        self.drag_all = np.array([one.drag_all for one in forces])
        self.friction_at = sorted({(dof, column) for one in forces for dof, column, _ in one.friction})
        self.friction = np.tile(list(NEUTRAL.values()), (len(jobs), len(self.friction_at), 1))
        nu = jobs[0].model.nu
        self.dead_zones, self.slopes = (np.zeros((len(jobs), nu)) for _ in range(2))
        self.lagging = [actuator for actuator, _ in forces[0].torque_lags]
        self.lags = np.array([[lag for _, lag in one.torque_lags] for one in forces])
        for index, one in enumerate(forces):
            for dof, column, law in one.friction:
                self.friction[index, self.friction_at.index((dof, column))] = law
            for actuator, width in one.dead_zones:
                self.dead_zones[index, actuator] = width
            for actuator, slope in one.speed_slopes:
                self.slopes[index, actuator] = slope

    def of(self, which: np.ndarray) -> Self:
        """Return the laws of rows, each of which belongs to a job."""
        chosen = copy.copy(self)
        for name in ("wind", "drag", "drag_all", "friction", "dead_zones", "slopes", "lags"):
            setattr(chosen, name, getattr(self, name)[which])
        return chosen


class _Pool:
    """A MuJoCo batch with the views that a transition needs; each row may have a model of its own."""

    def __init__(self, model: mujoco.MjModel, size: int):
        self.batch = Batch(model, nsim=size, nthread=max(1, min(size // ROWS_OF_THREAD, _thread_count())))
        self.model = model
        self.size, self.count = size, 0
        self.qpos, self.qvel, self.ctrl = (self.batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        self.time, self.warm = (self.batch.bind(name) for name in ("time", "qacc_warmstart"))
        self.xfrc, self.qfrc = (self.batch.bind(name) for name in ("xfrc_applied", "qfrc_applied"))
        self.act = self.batch.bind("act") if model.na else np.zeros((size, 0))
        self.active: np.ndarray | None = None
        self.failed = np.zeros(0, dtype=int)
        self.plays: tuple[Play, ...] = ()
        self.torques = np.zeros((0, 0))
        self._models: list[mujoco.MjModel] = []
        self._which = np.zeros(0, dtype=int)

    @property
    def ids(self) -> np.ndarray | None:
        """The rows to step, as MuJoCo wants them: None means all."""
        if self.active is not None:
            return self.active
        return None if self.count == self.size else np.arange(self.count)

    def load(
        self, states: Array, controls: Array, hidden: Array, plays: tuple[Play, ...], widths: Array
    ) -> None:
        """Set the rows to clean states. Before, the models are set and the forces applied."""
        count, na = len(states), self.act.shape[1]
        self.count, self.active, self.failed, self.plays = count, None, np.zeros(0, dtype=int), plays
        if plays:
            seen, seen_dofs = self._seen()
            self.qpos[:count, seen], self.qvel[:count, seen_dofs] = np.split(states, [len(seen)], axis=1)
        else:
            nq = self.qpos.shape[1]
            self.qpos[:count], self.qvel[:count] = states[:, :nq], states[:, nq:]
        self.ctrl[:count] = controls
        self.time[:count], self.warm[:count] = 0, 0
        if na:
            steady = self._steady(controls)
            self.act[:count] = np.where(np.isnan(hidden[:, :na]), steady, hidden[:, :na])
        lagging = hidden.shape[1] - na - 2 * len(plays)
        self.torques = hidden[:, na : na + lagging].copy()
        if plays:
            self._load_plays(hidden[:, na + lagging :].reshape(count, len(plays), 2), widths)

    def _steady(self, controls: Array) -> Array:
        """Return the steady activations (n_rows, na) of each row under its own model."""
        steady = np.empty((self.count, self.model.na))
        for index, model in enumerate(self._models):
            mine = self._which == index
            steady[mine] = steady_activations(model, controls[mine], self.qpos[: self.count][mine])
        return steady

    def _load_plays(self, hidden: Array, widths: Array) -> None:
        """Set the motors: where they were, or, as without play, at the flank that they press on."""
        count, unknown = self.count, np.isnan(hidden[:, :, 0])
        for play in self.plays:
            self.qpos[:count, play.play], self.qvel[:count, play.play_dof] = 0, 0
        pressed = np.zeros((count, len(self.plays)))
        if unknown.any():
            pressed = -np.sign(self._carried_by_plays())
            self.warm[:count] = 0
        for index, play in enumerate(self.plays):
            place = np.where(unknown[:, index], pressed[:, index] * widths[:, index] / 2, hidden[:, index, 0])
            speed = np.where(unknown[:, index], 0.0, hidden[:, index, 1])
            self.qpos[:count, play.play], self.qvel[:count, play.play_dof] = place, speed
            self.qpos[:count, play.joint] -= place
            self.qvel[:count, play.joint_dof] -= speed

    def _carried_by_plays(self) -> Array:
        """Return the force that goes from each motor to its link if these move as one, (n_rows, n_plays)."""
        bound = [self.batch.bind(name) for name in ("M", "qfrc_smooth", "qfrc_constraint")]
        self._forward(mujoco.mjtStage.mjSTAGE_ACC)
        entries, smooth, constraint = (values[: self.count] for values in bound)
        inertia = _dense(self.model, entries)
        loose = [play.play_dof for play in self.plays]
        rigid = [dof for dof in range(self.model.nv) if dof not in loose]
        forces = (smooth + constraint)[:, rigid, None]
        moved = np.linalg.solve(inertia[np.ix_(range(self.count), rigid, rigid)], forces)
        carried: Array = (inertia[np.ix_(range(self.count), loose, rigid)] @ moved)[..., 0] - smooth[:, loose]
        return carried

    def _seen(self) -> tuple[list[int], list[int]]:
        """Return the columns of qpos and qvel that the rows hold."""
        within = {play.play for play in self.plays}, {play.play_dof for play in self.plays}
        sizes = self.qpos.shape[1], self.qvel.shape[1]
        columns = [[one for one in range(size) if one not in taken] for size, taken in zip(sizes, within)]
        return columns[0], columns[1]

    def set_models(self, models: list[mujoco.MjModel], which: np.ndarray) -> None:
        """Have row i run on models[which[i]]; nothing is done if it does already."""
        same = len(models) == len(self._models) and all(a is b for a, b in zip(models, self._models))
        if same and np.array_equal(which, self._which):
            return
        self._set_models(models, which)
        self._models, self._which = models, which

    def _set_models(self, models: list[mujoco.MjModel], which: np.ndarray) -> None:
        rest = [models[-1]] * (self.size - len(which))
        self.batch.set_models(models[0] if len(models) == 1 else [models[index] for index in which] + rest)

    def settle(self, n_substeps: int, rest: Rest, laws: _Laws | None) -> Array:
        """Advance until each row is at rest, and return the states there; NaN where that takes too long.

        A row is stopped by its own motion alone, at the end of a block of substeps.
        """
        final = np.full((self.count, self.qpos.shape[1] + self.qvel.shape[1]), np.nan)
        active = np.arange(self.count)
        for _ in range(rest.max_blocks):
            self.active = active
            self.step(n_substeps, None, laws)
            done = rest.reached(self.qpos[active], self.qvel[active])
            final[active[done]] = self.states()[active[done]]
            active = active[~done]
            if not active.size:
                break
        self.active = None
        return final

    def step(
        self, n_substeps: int, controls: Array | None, laws: _Laws | None, seen: list[Array] | None = None
    ) -> None:
        """Advance; controls (n_rows, n_substeps, nu) change from substep to substep; `seen` gets each one's states."""
        if controls is None and seen is None:
            self._advance(n_substeps)
            return
        for substep in range(n_substeps):
            if controls is not None:
                self.ctrl[: self.count] = controls[:, substep]
            self._advance(1)
            if seen is not None:
                seen.append(self.states())

    def missing_forces(self, accelerations: Array, laws: _Laws | None) -> tuple[Array, Array]:
        """Return what accelerations (n_rows, nv) need beyond what acts, and the size of the dry friction."""
        bound = [self.batch.bind(name) for name in ("M", "qfrc_smooth")]
        self._forward(mujoco.mjtStage.mjSTAGE_ACC)
        entries, acting = (values[: self.count] for values in bound)
        forces = (_dense(self.model, entries) @ accelerations[..., None])[..., 0]
        return forces - acting, self._dry_friction()

    def constrained(self) -> NDArray[np.bool_]:
        """Return in which rows a constraint exerts a force."""
        forces = self.batch.bind("qfrc_constraint")
        self._forward(mujoco.mjtStage.mjSTAGE_ACC)
        return np.asarray((forces[: self.count] != 0).any(axis=1))

    def _dry_friction(self) -> Array:
        own = np.stack([model.dof_frictionloss for model in self._models])
        return np.asarray(own[self._which[: self.count]])

    def _forward(self, stage: mujoco.mjtStage) -> None:
        with suppress(SimulationError):
            self.batch.forward(self.ids, stage=int(stage))

    def states(self) -> Array:
        """Return the rows' states; NaN where MuJoCo gave up."""
        qpos, qvel = self.qpos[: self.count].copy(), self.qvel[: self.count].copy()
        for play in self.plays:
            qpos[:, play.joint] += qpos[:, play.play]
            qvel[:, play.joint_dof] += qvel[:, play.play_dof]
        if self.plays:
            seen, seen_dofs = self._seen()
            qpos, qvel = qpos[:, seen], qvel[:, seen_dofs]
        states = np.concatenate([qpos, qvel], axis=1)
        states[self.failed] = np.nan
        return states

    def hidden(self) -> Array:
        """Return the states that the rows do not hold."""
        count = self.count
        columns = [self.act[:count], self.torques]
        for play in self.plays:
            columns += [self.qpos[:count, [play.play]], self.qvel[:count, [play.play_dof]]]
        return np.concatenate(columns, axis=1)

    def _advance(self, n_substeps: int, stage: int = 0) -> None:
        try:
            self.batch.step(self.ids, nstep=n_substeps, stage=stage)
        except SimulationError as error:
            self.failed = np.union1d(self.failed, error.ids).astype(int)


class _ForcedPool(_Pool):
    """A batch whose forces are renewed in each substep.

    What differs between the models of its rows, and what the laws change, are values of a field of one model for each
    row: MuJoCo offers either that or models of one's own.
    """

    def __init__(self, model: mujoco.MjModel, size: int):
        super().__init__(model, size)
        self._fields: dict[str, Array] = {}
        self._limits: dict[str, Array] = {}
        self._servos: dict[str, Array] = {}

    def _set_models(self, models: list[mujoco.MjModel], which: np.ndarray) -> None:
        for name in sorted({name for model in models for name in _different(self.model, model)}):
            self._field(name)
        for name, values in self._fields.items():
            own = np.stack([np.asarray(_value(model, name)) for model in models])
            values[: len(which)] = own[which].reshape(values[: len(which)].shape)

    def _field(self, name: str) -> Array:
        """Return the values of a field of the model, a row each."""
        if name not in self._fields:
            self._fields[name] = self.batch.expand(name)
        return self._fields[name]

    def _own(self, name: str) -> Array:
        """Return the values of a field that the rows' models have, whatever a law has made of them."""
        own = np.stack([np.asarray(_value(model, name)) for model in self._models])
        return own[self._which]

    def step(
        self, n_substeps: int, controls: Array | None, laws: _Laws | None, seen: list[Array] | None = None
    ) -> None:
        """Advance substep by substep, with the forces renewed from the state at each one's start."""
        if laws is None:
            raise AssertionError("unreachable: rows without laws run in another batch")
        count = self.count
        # What depends on velocities is that of a substep's start, the load on gears that of the substep before.
        at_start = bool(laws.kinds - {"friction", "load"})
        stage = int(mujoco.mjtStage.mjSTAGE_VEL if at_start else mujoco.mjtStage.mjSTAGE_NONE)
        own, bound = self._prepared(laws)
        plain = self.ctrl[:count].copy()
        for substep in range(n_substeps):
            self._renew(laws, plain if controls is None else controls[:, substep], own, bound)
            self._advance(1, stage)
            if seen is not None:
                seen.append(self.states())
        for name in own:
            self._field(name)[:count] = own[name]

    def missing_forces(self, accelerations: Array, laws: _Laws | None) -> tuple[Array, Array]:
        """Return what accelerations (n_rows, nv) need beyond what acts, and the size of the dry friction."""
        if laws is None:
            raise AssertionError("unreachable: rows without laws run in another batch")
        own, seen = self._prepared(laws)
        self._renew(laws, self.ctrl[: self.count].copy(), own, seen)
        found = super().missing_forces(accelerations, laws)
        for name in own:
            self._field(name)[: self.count] = own[name]
        return found

    def _dry_friction(self) -> Array:
        return self._field("dof_frictionloss")[: self.count].copy()

    def _prepared(self, laws: _Laws) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return fields of the rows' models that laws change, and what they depend on, as it is at the start."""
        count, kinds = self.count, laws.kinds
        changed = {
            "friction": ("dof_frictionloss",),
            "speed_slopes": ("actuator_forcerange",),
            "torque_lags": SERVOS,
        }
        own = {name: self._own(name) for kind in changed if kind in kinds for name in changed[kind]}
        for name in own:
            self._field(name)[:count] = own[name]
        self._limits = {name: self._own(name) for name in LIMITS} if "torque_lags" in kinds else {}
        self._servos = {name: self._own(name) for name in SERVOS} if "dead_zones" in kinds else {}
        bound = {
            "drag": ("cvel", "xipos", "subtree_com"),
            "load": ("qfrc_bias", "qfrc_spring", "qfrc_actuator"),
            "dead_zones": ("actuator_length",),
            "speed_slopes": ("actuator_velocity",),
            "torque_lags": ("actuator_length", "actuator_velocity"),
        }
        seen = {name: self.batch.bind(name) for kind in bound if kind in kinds for name in bound[kind]}
        if seen:
            self._forward(mujoco.mjtStage.mjSTAGE_ACC if "load" in kinds else mujoco.mjtStage.mjSTAGE_VEL)
            self.warm[:count] = 0
        return own, seen

    def _renew(self, laws: _Laws, controls: Array, own: dict[str, Array], seen: dict[str, Array]) -> None:
        """Apply the laws at the state that is loaded."""
        count, kinds = self.count, laws.kinds
        if "dead_zones" in kinds:
            missing = controls - _idle_controls(self._servos, seen["actuator_length"][:count], controls)
            controls = controls - np.clip(missing, -laws.dead_zones, laws.dead_zones)
        self.ctrl[:count] = controls
        if "friction" in kinds:
            self._brake(laws, own["dof_frictionloss"], seen)
        if "drag" in kinds:
            self._drag(laws, seen)
        if "speed_slopes" in kinds:
            self._tire(laws, own["actuator_forcerange"], seen)
        if "torque_lags" in kinds:
            self._lag(laws, own, seen)

    def _brake(self, laws: _Laws, own: Array, seen: dict[str, Array]) -> None:
        count = self.count
        motor, external = np.zeros((2, count, self.qvel.shape[1]))
        if "load" in laws.kinds:
            motor = seen["qfrc_actuator"][:count]
            external = seen["qfrc_spring"][:count] - seen["qfrc_bias"][:count]
        dofs, columns = (list(one) for one in zip(*laws.friction_at))
        state = self.qpos[:count, columns], self.qvel[:count, dofs], motor[:, dofs], external[:, dofs]
        self._field("dof_frictionloss")[:count, dofs] = own[:, dofs] + budget(laws.friction, *state)

    def _drag(self, laws: _Laws, seen: dict[str, Array]) -> None:
        count, body = self.count, laws.body
        spatial, place, centre = (seen[name][:count] for name in ("cvel", "xipos", "subtree_com"))
        arm = place[:, body] - centre[:, int(self.model.body_rootid[body])]
        velocity = spatial[:, body, 3:] + np.cross(spatial[:, body, :3], arm)
        force = laws.wind - laws.drag * np.abs(velocity) * velocity
        force = force - laws.drag_all[:, None] * np.linalg.norm(velocity, axis=1, keepdims=True) * velocity
        self.xfrc[:count, body, :3] = force

    def _tire(self, laws: _Laws, own: Array, seen: dict[str, Array]) -> None:
        limits = own - (laws.slopes * seen["actuator_velocity"][: self.count])[:, :, None]
        limits = np.clip(limits, own[:, :, :1], own[:, :, 1:])
        tires = laws.slopes > 0
        self._field("actuator_forcerange")[: self.count][tires] = limits[tires]

    def _lag(self, laws: _Laws, own: dict[str, Array], seen: dict[str, Array]) -> None:
        """Have actuators' forces follow what they should be.

        Of what a filter makes of a constant input, the mean over the substep acts: a share of the input, with its
        dependence on place and speed, so that the integrator treats it as without a filter, and what is left of before.
        """
        at, count = laws.lagging, self.count
        lengths, speeds = seen["actuator_length"][:count], seen["actuator_velocity"][:count]
        free, wanted = _forces_of(self._limits, own, self.ctrl[:count], lengths, speeds)
        if "speed_slopes" in laws.kinds:
            low, high = np.moveaxis(self._field("actuator_forcerange")[:count], 2, 0)
            wanted = np.where(laws.slopes > 0, np.clip(wanted, low, high), wanted)
        saturated, wanted = (free != wanted)[:, at, None], wanted[:, at]
        self.torques = np.where(np.isnan(self.torques), wanted, self.torques)
        step = float(self._models[0].opt.timestep) / laws.lags
        way = -np.expm1(-step)
        now = (1 - way / step)[:, :, None]
        gain, bias = now * own["actuator_gainprm"][:, at], now * own["actuator_biasprm"][:, at]
        gain, bias = np.where(saturated, 0, gain), np.where(saturated, 0, bias)
        bias[:, :, 0] += np.where(saturated[..., 0], now[..., 0] * wanted, 0) + self.torques * way / step
        self._field("actuator_gainprm")[:count, at], self._field("actuator_biasprm")[:count, at] = gain, bias
        self.torques = self.torques + way * (wanted - self.torques)


def _mark_diverged(states: Array) -> None:
    """Have states (..., n_states) that are no longer finite be NaN throughout."""
    states[~(np.abs(states) < HUGE).all(axis=-1)] = np.nan


def _alike(jobs: Sequence[Job]) -> list[list[int]]:
    """Return which jobs can run in one batch."""
    together: dict[tuple[Any, ...], list[int]] = {}
    for index, job in enumerate(jobs):
        shape = _sizes(job.model), tuple((play.joint, play.play) for play in job.plays)
        forced = (job.forces.kinds, _rigid_parts(job.model)) if job.forces.kinds else ()
        lags = tuple(actuator for actuator, _ in job.forces.torque_lags)
        key = (forced, lags, job.controls is not None, job.n_substeps, shape)
        together.setdefault(key, []).append(index)
    return list(together.values())


def _dense(model: mujoco.MjModel, entries: Array) -> Array:
    """Return the mass matrices (n_rows, nv, nv) of rows from their lower triangles (n_rows, nC)."""
    rows, columns = np.repeat(np.arange(model.nv), model.M_rownnz), model.M_colind
    found = np.zeros((len(entries), model.nv, model.nv))
    found[:, rows, columns] = found[:, columns, rows] = entries
    return found


def _idle_controls(parameters: dict[str, Array], length: Array, controls: Array) -> Array:
    """Return the controls (n_rows, nu) at which actuators at rest exert nothing; those given where none is so."""
    gain, bias = (parameters[name] for name in SERVOS)
    slope = gain[..., 0] + gain[..., 1] * length
    force = bias[..., 0] + bias[..., 1] * length
    return np.where(slope, -force / np.where(slope, slope, 1.0), controls)


def _forces_of(
    own: dict[str, Array], parameters: dict[str, Array], controls: Array, length: Array, speed: Array
) -> tuple[Array, Array]:
    """Return the force (n_rows, nu) of actuators that are affine in length and speed, and the same within limits."""
    gain, bias = parameters["actuator_gainprm"], parameters["actuator_biasprm"]
    limits, limited = own["actuator_ctrlrange"], own["actuator_ctrllimited"]
    controls = np.where(limited, np.clip(controls, limits[..., 0], limits[..., 1]), controls)
    force = (gain[..., 0] + gain[..., 1] * length + gain[..., 2] * speed) * controls
    force = force + bias[..., 0] + bias[..., 1] * length + bias[..., 2] * speed
    limits, limited = own["actuator_forcerange"], own["actuator_forcelimited"]
    return force, np.where(limited, np.clip(force, limits[..., 0], limits[..., 1]), force)


def steady_activations(model: mujoco.MjModel, controls: Array, qpos: Array) -> Array:
    """Return activations (n_rows, na) that the controls, held for long, leave as they are.

    Those of a filter or a muscle are the control within its range. An integrator that is a place to go to is where its
    joint is. Others are zero: the integral of a pid, the current of a motor.
    """
    steady = np.zeros((len(controls), model.na))
    for actuator in range(model.nu):
        first, count = int(model.actuator_actadr[actuator]), int(model.actuator_actnum[actuator])
        if count < 1:
            continue
        control, last = controls[:, actuator], first + count - 1
        if model.actuator_ctrllimited[actuator]:
            control = np.clip(control, *model.actuator_ctrlrange[actuator])
        kind = int(model.actuator_dyntype[actuator])
        if kind in FILTERS:
            steady[:, last] = np.clip(control, 0, 1) if kind == MUSCLE else control
        elif kind == INTEGRATOR and int(model.actuator_trntype[actuator]) in JOINT_TRANSMISSIONS:
            joint = int(model.actuator_trnid[actuator, 0])
            if model.actuator_biasprm[actuator, 1]:
                steady[:, last] = model.actuator_gear[actuator, 0] * qpos[:, model.jnt_qposadr[joint]]
        if model.actuator_actlimited[actuator]:
            steady[:, last] = np.clip(steady[:, last], *model.actuator_actrange[actuator])
    return steady


@functools.lru_cache(maxsize=512)
def _different(first: mujoco.MjModel, second: mujoco.MjModel) -> tuple[str, ...]:
    """Return the fields in which two models of one layout differ."""
    if first is second:
        return ()
    return tuple(
        name
        for name in MODEL_FIELDS
        if not name.startswith("name") and not _same(_value(first, name), _value(second, name))
    )


def _same(first: object, second: object) -> bool:
    # By bytes, which is several times as fast as by values and holds NaN for equal to itself.
    return np.asarray(first).tobytes() == np.asarray(second).tobytes()


def _value(model: mujoco.MjModel, name: str) -> object:
    return getattr(model.opt, name[4:]) if name.startswith("opt.") else getattr(model, name)


def _rigid_parts(model: mujoco.MjModel) -> tuple[int, ...]:
    """Return what tells apart models that differ in what no field of a row can hold.

    That are their meshes and height fields, and how many pairs of geoms they name.
    """
    hashes = (hash(part.tobytes()) for part in (model.mesh_vert, model.hfield_data) if part.size)
    return (int(model.npair), int(model.nexclude), *hashes)


def _sizes(model: mujoco.MjModel) -> tuple[int, ...]:
    """Return the sizes that models must share to run in one batch."""
    return (
        model.nq, model.nv, model.nu, model.nbody, model.njnt, model.ngeom, model.nsite, model.ntendon,
        model.neq, model.nM, model.nC, model.nB, model.nD, model.nsensordata, model.nuserdata, model.nmocap,
        model.na,
    )  # fmt: skip


def _thread_count() -> int:
    """Return how many threads to use: the processors there are; in a worker process its share of them.

    joblib and dask tell their workers the share by OMP_NUM_THREADS.
    """
    share = os.environ.get("OMP_NUM_THREADS", "")
    if multiprocessing.parent_process() is not None and share.isdigit() and int(share) > 0:
        return min(int(share), int(joblib.cpu_count()))
    return int(joblib.cpu_count())


@contextmanager
def quiet() -> Iterator[None]:
    """Keep MuJoCo from writing a log file about rows that diverge; they are reported as NaN."""
    before = mujoco.MjLogConfig.get()
    quiet = mujoco.MjLogConfig.get()
    quiet.logto_file, quiet.logto_console = False, False
    quiet.set()
    try:
        yield
    finally:
        before.set()
