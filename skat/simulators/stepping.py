"""Stepping many rows under many models at once, on MuJoCo's thread pool.

Each row starts from a clean state: its own positions, velocities and controls, time zero, no warm start of
the constraint solver and no applied forces. So the result of a row does not depend on other rows, on their
order, or on how they are cut into chunks.
"""

import math
import multiprocessing
import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import joblib
import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from skat.simulators.tables import Array

CHUNK = 8192
CACHED_BATCHES = 32
HUGE = 1e10  # MuJoCo's own limit of a state that is not divergent

_left_to_other_processes: list[object] = []


@dataclass(frozen=True)
class Forces:
    """Forces on the rows of one candidate that a model does not express.

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
    position_friction : tuple of (dof, column of qpos, coefficient)
        Dry friction of coefficient times |q|.
    joints : tuple of (dof, force)
        Constant generalised forces, N or N m.
    """

    body: int = 0
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drag: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drag_all: float = 0.0
    position_friction: tuple[tuple[int, int, float], ...] = ()
    joints: tuple[tuple[int, float], ...] = ()

    @property
    def has_drag(self) -> bool:
        """Whether the force depends on the velocity."""
        return any(self.drag) or self.drag_all != 0

    @property
    def changes_within_transition(self) -> bool:
        """Whether each substep needs its own forces."""
        return self.has_drag or bool(self.position_friction)


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
    """

    candidate: int
    model: mujoco.MjModel
    n_substeps: int
    forces: Forces = field(default_factory=Forces)
    controls: Array | None = None


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

    def run(self, jobs: Sequence[Job], inputs: Array, *, rest: Rest | None = None) -> Array:
        """Return the states after each job: after its substeps, or once they are at rest.

        Parameters
        ----------
        jobs : sequence of Job
        inputs : ndarray of shape (n_candidates, n_rows, nq + nv + nu)
        rest : Rest, optional
            Repeat the substeps until each row is at rest.

        Returns
        -------
        ndarray of shape (n_jobs, n_rows, nq + nv)
            NaN where the simulation diverged.
        """
        model = jobs[0].model
        states = np.empty((len(jobs), inputs.shape[1], model.nq + model.nv))
        together: dict[tuple[Any, ...], list[int]] = {}
        for index, job in enumerate(jobs):
            alone = index if job.forces.changes_within_transition else -1
            key = (alone, job.controls is not None, job.n_substeps, _layout(job.model))
            together.setdefault(key, []).append(index)
        with self._lock, _quiet():
            self._forget_batches_of_parent()
            for members in together.values():
                self._run_together([jobs[index] for index in members], members, inputs, states, rest)
        diverged = ~(np.abs(states) < HUGE).all(axis=2)
        states[diverged] = np.nan
        return states

    def _run_together(
        self, jobs: list[Job], slots: list[int], inputs: Array, states: Array, rest: Rest | None
    ) -> None:
        n_rows, n_states = states.shape[1:]
        total = len(jobs) * n_rows
        pool = self._pool(jobs[0], min(total, CHUNK))
        candidates = np.array([job.candidate for job in jobs])
        destinations = np.array(slots)
        winds = np.array([job.forces.wind for job in jobs])
        generalised = np.zeros((len(jobs), jobs[0].model.nv))
        for forces, job in zip(generalised, jobs):
            for dof, force in job.forces.joints:
                forces[dof] = force
        for start in range(0, total, CHUNK):
            flat = np.arange(start, min(start + CHUNK, total))
            which, row = np.divmod(flat, n_rows)
            source = inputs[candidates[which], row]
            pool.load(source[:, :n_states], source[:, n_states:])
            if pool.model is None:
                pool.set_models(
                    [jobs[index].model for index in range(which[0], which[-1] + 1)], which - which[0]
                )
            controls = None
            if jobs[0].controls is not None:
                controls = np.stack([jobs[job].controls[index] for job, index in zip(which, row)])
            pool.xfrc[: len(flat), jobs[0].forces.body, :3] = winds[which]
            pool.qfrc[: len(flat)] = generalised[which]
            if rest is None:
                pool.step(jobs[0].n_substeps, jobs[0].forces, controls)
                states[destinations[which], row] = pool.states()
            else:
                states[destinations[which], row] = pool.settle(jobs[0].n_substeps, jobs[0].forces, rest)

    def _pool(self, job: Job, size: int) -> "_Pool":
        """Return a cached batch of at least this size."""
        size = 1 << max(size - 1, 0).bit_length()
        forced = job.forces.changes_within_transition
        key = (size, id(job.model) if forced else _layout(job.model), bool(job.forces.position_friction))
        if key not in self._batches:
            self._batches[key] = _Pool(job.model, size, own_model=forced)
            if len(self._batches) > CACHED_BATCHES:
                self._batches.popitem(last=False)
        self._batches.move_to_end(key)
        return self._batches[key]

    def _forget_batches_of_parent(self) -> None:
        """After a fork the threads of inherited batches do not exist; closing them would wait forever."""
        if self._process != os.getpid():
            _left_to_other_processes.append(self._batches)
            self._batches, self._process = OrderedDict(), os.getpid()


class _Pool:
    """A MuJoCo batch with the views that a transition needs."""

    def __init__(self, model: mujoco.MjModel, size: int, *, own_model: bool):
        self.batch = Batch(model, nsim=size, nthread=min(size, _thread_count()))
        self.model = model if own_model else None
        self.size, self.count = size, 0
        self.qpos, self.qvel, self.ctrl = (self.batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        self.time, self.warm = (self.batch.bind(name) for name in ("time", "qacc_warmstart"))
        self.xfrc, self.qfrc = (self.batch.bind(name) for name in ("xfrc_applied", "qfrc_applied"))
        self.active: np.ndarray | None = None
        self.failed = np.zeros(0, dtype=int)
        self._models: list[mujoco.MjModel] = []
        self._which = np.zeros(0, dtype=int)

    @property
    def ids(self) -> np.ndarray | None:
        """The rows to step, as MuJoCo wants them: None means all."""
        if self.active is not None:
            return self.active
        return None if self.count == self.size else np.arange(self.count)

    def load(self, states: Array, controls: Array) -> None:
        """Set the rows to clean states."""
        count, nq = len(states), self.qpos.shape[1]
        self.count, self.active, self.failed = count, None, np.zeros(0, dtype=int)
        self.qpos[:count], self.qvel[:count] = states[:, :nq], states[:, nq:]
        self.ctrl[:count] = controls
        self.time[:count], self.warm[:count], self.xfrc[:count] = 0, 0, 0

    def set_models(self, models: list[mujoco.MjModel], which: np.ndarray) -> None:
        """Have row i run on models[which[i]]; nothing is done if it does already."""
        same = len(models) == len(self._models) and all(a is b for a, b in zip(models, self._models))
        if same and np.array_equal(which, self._which):
            return
        rest = [models[-1]] * (self.size - len(which))
        self.batch.set_models(models[0] if len(models) == 1 else [models[index] for index in which] + rest)
        self._models, self._which = models, which

    def settle(self, n_substeps: int, forces: Forces, rest: Rest) -> Array:
        """Advance until each row is at rest, and return the states there; NaN where that takes too long.

        A row is stopped by its own motion alone, at the end of a block of substeps.
        """
        final = np.full((self.count, self.qpos.shape[1] + self.qvel.shape[1]), np.nan)
        active = np.arange(self.count)
        for _ in range(rest.max_blocks):
            self.active = active
            self.step(n_substeps, forces, None)
            done = rest.reached(self.qpos[active], self.qvel[active])
            final[active[done]] = self.states()[active[done]]
            active = active[~done]
            if not active.size:
                break
        self.active = None
        return final

    def step(self, n_substeps: int, forces: Forces, controls: Array | None) -> None:
        """Advance; controls of shape (n_rows, n_substeps, nu) change from substep to substep."""
        if forces.changes_within_transition:
            self._step_forced(forces, n_substeps, controls)
            return
        if controls is None:
            self._advance(n_substeps)
            return
        for substep in range(n_substeps):
            self.ctrl[: self.count] = controls[:, substep]
            self._advance(1)

    def _step_forced(self, forces: Forces, n_substeps: int, controls: Array | None) -> None:
        """Advance substep by substep, with the forces renewed from the state at each one's start."""
        count, body = self.count, forces.body
        model: mujoco.MjModel = self.batch.get_model(0) if self.model is None else self.model
        if forces.position_friction:
            friction = self.batch.expand("dof_frictionloss")
            friction[:] = model.dof_frictionloss  # the batch may have run with friction in other joints
        stage = mujoco.mjtStage.mjSTAGE_VEL if forces.has_drag else mujoco.mjtStage.mjSTAGE_NONE
        if forces.has_drag:
            spatial, place, centre = (self.batch.bind(name) for name in ("cvel", "xipos", "subtree_com"))
            with suppress(SimulationError):
                self.batch.forward(self.ids, stage=int(stage))
        for substep in range(n_substeps):
            if controls is not None:
                self.ctrl[:count] = controls[:, substep]
            for dof, column, coefficient in forces.position_friction:
                friction[:count, dof] = model.dof_frictionloss[dof] + coefficient * np.abs(
                    self.qpos[:count, column]
                )
            force = np.broadcast_to(forces.wind, (count, 3))
            if forces.has_drag:
                arm = place[:count, body] - centre[:count, int(model.body_rootid[body])]
                velocity = spatial[:count, body, 3:] + np.cross(spatial[:count, body, :3], arm)
                force = force - np.array(forces.drag) * np.abs(velocity) * velocity
                force = force - forces.drag_all * np.linalg.norm(velocity, axis=1, keepdims=True) * velocity
            self.xfrc[:count, body, :3] = force
            self._advance(1, int(stage))

    def states(self) -> Array:
        """Return the rows' states; NaN where MuJoCo gave up."""
        states = np.concatenate([self.qpos[: self.count], self.qvel[: self.count]], axis=1)
        states[self.failed] = np.nan
        return states

    def _advance(self, n_substeps: int, stage: int = 0) -> None:
        try:
            self.batch.step(self.ids, nstep=n_substeps, stage=stage)
        except SimulationError as error:
            self.failed = np.union1d(self.failed, error.ids).astype(int)


def delayed_controls(controls: Array, history: Array | None, lag: float, n_substeps: int) -> Array:
    """Return the controls of each substep that come ``lag`` substeps late, linear between substeps.

    Parameters
    ----------
    controls : ndarray of shape (n_rows, nu)
    history : ndarray of shape (n_rows, n_lags, nu)
        Controls of the transitions before: one back, two back, ...
    lag : float
    n_substeps : int

    Returns
    -------
    ndarray of shape (n_rows, n_substeps, nu)
    """
    known = controls[:, None] if history is None else np.concatenate([controls[:, None], history], axis=1)
    delayed = np.empty((len(controls), n_substeps, controls.shape[1]))
    for substep in range(n_substeps):
        moment = substep - lag
        before = math.floor(moment + 1e-9)
        weight = moment - before
        earlier, later = (
            known[:, -math.floor(index / n_substeps)] for index in (before, min(before + 1, substep))
        )
        delayed[:, substep] = earlier if weight <= 1e-9 else (1 - weight) * earlier + weight * later
    return delayed


def _layout(model: mujoco.MjModel) -> tuple[int, ...]:
    """Return the sizes that models must share to run in one batch."""
    return (
        model.nq, model.nv, model.nu, model.nbody, model.njnt, model.ngeom, model.nsite, model.ntendon,
        model.neq, model.nM, model.nC, model.nB, model.nD, model.nsensordata, model.nuserdata, model.nmocap,
    )  # fmt: skip


def _thread_count() -> int:
    """Return how many threads to use: the processors there are; in a worker process its share of them.

    joblib and dask tell their workers the share by OMP_NUM_THREADS.
    """
    share = os.environ.get("OMP_NUM_THREADS", "")
    if multiprocessing.parent_process() is not None and share.isdigit() and int(share) > 0:
        return min(int(share), joblib.cpu_count())
    return joblib.cpu_count()


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep MuJoCo from writing a log file about rows that diverge; they are reported as NaN."""
    before = mujoco.MjLogConfig.get()
    quiet = mujoco.MjLogConfig.get()
    quiet.logto_file, quiet.logto_console = False, False
    quiet.set()
    try:
        yield
    finally:
        before.set()
