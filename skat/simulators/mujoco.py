"""Any MuJoCo model as a simulator: rows of [qpos, qvel, ctrl] in, rows of the next [qpos, qvel] out."""

import copy
import json
import math
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from skat.effects import FAMILIES, Effect
from skat.files import whole, writable
from skat.simulators.anatomy import EXPLICIT_INTEGRATOR, INTEGRATOR, NO_DYNAMICS, Anatomy, actuator_name
from skat.simulators.base import Acting, Courses, Simulator, sensor_lags
from skat.simulators.catalogue import MOST_STEPS, Listing, effect_listing
from skat.simulators.channels import FREE, HINGE, StateLayout, joint_name, state_layout
from skat.simulators.commands import CommandPath
from skat.simulators.compiling import checked_model, compile_spec, lean_spec
from skat.simulators.derived import write_down
from skat.simulators.edits import PLAY, add_payload, finish_plays
from skat.simulators.friction import NEUTRAL, braking_share, creep
from skat.simulators.furnishing import with_base, with_motors
from skat.simulators.parts import parts_of, places_of_effects
from skat.simulators.source import (
    NOTES,
    ModelSource,
    broken_model,
    differing_fields,
    read_source,
    write_xml,
)
from skat.simulators.stepping import Forces, Job, Play, Stepper, steady_activations
from skat.simulators.tables import Array, episode_starts
from skat.simulators.urdf import DERIVED, HELD, HELD_OF_JOINTS, edited_urdf

CACHED_MODELS = 256
# Families whose edit only makes room in the model for what the stepping does.
PREPARED = ("torque_speed", "lag_torque")
# Families that need the stepping; with those of `friction.budget`.
STEPPED = ("wind", "air_drag", "force", "dead_zone", *PREPARED)
# Families that a written model has beside it, and with them what comes before them: what is done to commands.
BEHIND_COMMANDS = ("dead_zone", *PREPARED)
RUNGE_KUTTA = int(mujoco.mjtIntegrator.mjINT_RK4)
# Families that act by their names, whatever an edit says.
RESERVED = ("bias", "scale", "lag", "delay", "timestep", "backlash", "payload", *PREPARED)


class MujocoSimulator(Simulator):
    """A MuJoCo model as a simulator.

    X = [qpos, qvel, ctrl], y = [qpos, qvel] after ``frame_skip`` time steps.

    Every row starts from a clean state: time zero, no warm start of the constraint solver. All rows, under
    all candidate effects, run in one call of ``mujoco.batch``. Activations of actuators are hidden states, which rows
    do not hold: they begin each episode steady and are carried from row to row (`hidden_state_names`).

    Parameters
    ----------
    model : path, str, mujoco.MjSpec or mujoco.MjModel
        Path of an MJCF or URDF file, or of a robot's folder as in MuJoCo Menagerie; MJCF or URDF text; a MjSpec; the
        MjModel that MuJoCo read last. It is read at once; the simulator holds the text and assets, so it pickles,
        deep-copies and survives `sklearn.base.clone`.
    frame_skip : int, default=1
        Time steps per transition.
    base : {"fixed", "free"}, optional
        Whether the root is welded to the world where the model places it, or moves freely. Needed for a URDF without
        a joint to the world; by default as the model says.
    motors : str, optional
        ``"torque"`` or ``"position:kp,kv"``: what drives each joint of a model without actuators, as a URDF is,
        within the URDF's effort limits. ``"none"``: nothing, also where a log has commands.
    built_in : mapping from name to value, optional
        Effects that are built in; see `extended`.
    extra_effects : sequence of Effect, default=()
        Effects of your own, whose ``apply(spec, value)`` edits a copied ``mujoco.MjSpec``.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If MuJoCo cannot read the model; if it has a memory that can be neither held by rows nor carried along them; if
        an extra effect has the name of another one.

    Examples
    --------
    >>> from skat.simulators import MujocoSimulator
    >>> ball = MujocoSimulator('''
    ... <mujoco>
    ...   <worldbody>
    ...     <body name="ball">
    ...       <joint name="fall" type="slide" axis="0 0 1"/><geom size="0.1" mass="0.5"/>
    ...     </body>
    ...   </worldbody>
    ... </mujoco>''', frame_skip=50)
    >>> ball.input_names
    ('qpos.fall', 'qvel.fall')
    >>> ball.predict([[2.0, 0.0]], effects={"air_drag[z]": 0.5}).round(4)
    array([[ 1.9508, -0.9493]])
    """

    def __init__(
        self,
        model: str | PathLike[str] | mujoco.MjSpec | mujoco.MjModel | ModelSource,
        *,
        frame_skip: int = 1,
        base: str | None = None,
        motors: str | None = None,
        built_in: Mapping[str, float] | None = None,
        extra_effects: Sequence[Effect] = (),
    ):
        # Text, as a MjSpec can be neither copied nor pickled.
        self.model = with_motors(with_base(read_source(model), base), motors)
        self.frame_skip = frame_skip
        self.base = base
        self.motors = motors
        self.built_in = built_in
        self.extra_effects = extra_effects
        self._nominal  # noqa: B018 - a model that does not compile is of no use to anybody

    def __repr__(self) -> str:
        parts = [repr(self._nominal_name), f"frame_skip={self.frame_skip}"]
        if self.built_in:
            parts.append(f"built_in={dict(self.built_in)}")
        return f"{type(self).__name__}({', '.join(parts)})"

    @property
    def state_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the state's columns, [qpos, qvel]."""
        return self._layout.names

    @property
    def input_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the columns of X, [qpos, qvel, ctrl]."""
        return (*self._layout.names, *self._cached("controls", self._control_names))

    @property
    def output_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the columns of y, those of the state."""
        return self._layout.names

    @property
    def residual_names(self) -> tuple[str, ...]:
        """Names of the columns of a residual; a rotation vector ``rx, ry, rz`` stands for a quaternion."""
        return self._layout.tangent_names

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column of the state and of a residual, by name."""
        # What the tangent space has beside the columns of the state are rotation vectors.
        return dict.fromkeys(self._layout.tangent_names, "rad") | dict(
            zip(self._layout.names, self._layout.units)
        )

    @property
    def reference_state(self) -> Array:
        """The model's ``qpos0``, at rest."""
        return np.concatenate([self._nominal.qpos0, np.zeros(self._nominal.nv)])

    @property
    def angle_names(self) -> tuple[str, ...]:
        """Names of the positions and velocities of hinges."""
        model = self._nominal
        hinges = [joint_name(model, joint) for joint in range(model.njnt) if model.jnt_type[joint] == HINGE]
        return tuple(f"{kind}.{hinge}" for kind in ("qpos", "qvel") for hinge in hinges)

    @property
    def command_limits(self) -> dict[str, tuple[float, float]]:
        """The ``ctrlrange`` of each actuator that has one."""
        model = self._nominal
        names = self._cached("controls", self._control_names)
        limits = zip(names, model.actuator_ctrllimited, model.actuator_ctrlrange)
        return {name: (float(low), float(high)) for name, limited, (low, high) in limits if limited}

    @property
    def servo_limits(self) -> dict[str, float]:
        """Largest force on its joint of each servo that has a limit, N or N m, by the servo's name."""
        limited, names = self._nominal.actuator_forcelimited & self._feeds_back, self._actuator_names
        return {
            names[index]: self._anatomy.capacity(index)
            for index in self._anatomy.joint_driven
            if limited[index]
        }

    @property
    def dt(self) -> float:  # type: ignore[override]
        """Duration of a transition, s."""
        return self.frame_skip * self.time_step

    @property
    def time_step(self) -> float:
        """Of the model, s."""
        return float(self._nominal.opt.timestep)

    def residual(self, y: ArrayLike, prediction: ArrayLike) -> Array:
        """Return the difference "y minus prediction" in the tangent space of the prediction.

        As ``mj_differentiatePos``: the rotation vector, in the body's frame, that turns the predicted
        orientation into that of y.

        Parameters
        ----------
        y, prediction : array-like of shape (..., n_states)

        Returns
        -------
        ndarray of shape (..., n_residuals)
        """
        layout = self._layout
        return layout.difference(
            layout.normalised(np.asarray(y, float), "y"),
            layout.normalised(np.asarray(prediction, float), "prediction"),
        )

    def displace(self, X: ArrayLike, tangent: ArrayLike) -> Array:
        """Return the rows with their state moved by a tangent vector, as ``mj_integratePos``.

        Parameters
        ----------
        X : array-like of shape (..., n_inputs) or (..., n_states)
        tangent : array-like of shape (..., n_residuals)

        Returns
        -------
        ndarray of the shape of X
        """
        rows, tangent = np.asarray(X, float), np.asarray(tangent, float)
        n_states = len(self.state_names)
        shape = np.broadcast_shapes(rows.shape[:-1], tangent.shape[:-1])
        moved = np.array(np.broadcast_to(rows, (*shape, rows.shape[-1])))
        states = self._layout.normalised(moved[..., :n_states], "X")
        moved[..., :n_states] = self._layout.displaced(states, tangent)
        return moved

    def _reads_delayed(self, spec: mujoco.MjSpec, effect: Effect, values: Mapping[str, float]) -> bool:
        """Whether MuJoCo delays controls as this simulator does: between time steps, by one of them at least.

        Where the model's own delay holds controls, it would hold all of it, and so only whole time steps are the same.
        """
        delay = values[effect.name]
        step = float(self._nominal.opt.timestep) * max(1.0, values.get("timestep", 1.0))
        if int(spec.option.integrator) == EXPLICIT_INTEGRATOR or delay < step:
            return False
        steps = delay / float(spec.option.timestep)
        late = [effect.target in ("action", name) for name in self._actuator_names]
        return abs(steps - round(steps)) < 1e-9 or not (self._native_delays[1] & late).any()

    def to_mjcf(self, path: str | PathLike[str], *, force: bool = False) -> tuple[Path, ...]:
        """Write the model, with the effects that are built in, for any user of MuJoCo.

        Numbers are written with all digits: plain MuJoCo predicts what this simulator predicts, under a ``lag`` nearly,
        as its filter acts as it is at the end of a time step. Before the first command it has commands of zero. A time
        step that does not divide a transition is written as the nearest one that does; the notes beside the model say
        so. What MJCF cannot express (wind, drag on bodies that turn, friction that grows with position or load or falls
        with speed, forces on joints, dead zones, torque that lags or falls with speed, sensors, a delay shorter than a
        time step, any under the Runge-Kutta integrator, which reads delayed controls between time steps, and what lies
        between a command and an actuator that integrates it, but a delay) is written beside it, into
        ``<name>.effects.json``, and so is what is done to the command of an actuator with a dead zone or with torque
        that lags or falls with speed. A ``backlash`` is written as a joint of its own, ``<joint>.play``.

        Parameters
        ----------
        path : path
            Where to write the MJCF; assets are written into the same folder.
        force : bool, default=False
            Whether to overwrite files that exist. Assets that are there with the same content are left as they are.

        Returns
        -------
        tuple of Path
            The files of the model.

        Raises
        ------
        FileExistsError
            If one of the files exists and `force` is False; nothing is written then.
        FileNotFoundError
            If the folder does not exist.
        """
        target = writable(path, force=force)
        values = self._built_in()
        spec = self.model.spec()
        write_down(spec)
        substeps = self.frame_skip
        beside: dict[str, float] = {}
        rounded: dict[str, float] = {}
        edits = {effect.name: edit for effect, edit in self._edited(values)}
        kept = self._kept_commands(values)
        for effect in self._edit_order(values):
            value = values[effect.name]
            of_payload = effect.family == "payload" and effect.unit == "m"
            if effect.family == "timestep":
                substeps = min(round(self.frame_skip / value) or 1, MOST_STEPS * self.frame_skip)
                written = self.frame_skip / substeps
                if len(self._substeps(values)) > 1:
                    rounded[effect.name] = written
                edits[effect.name](spec, written)
                continue
            fits = effect.family != "delay" or self._reads_delayed(spec, effect, values)
            is_written = effect.name in edits and fits and effect.name not in kept
            if is_written:
                edits[effect.name](spec, value)
            if (not is_written and not of_payload) or effect.family in PREPARED:
                beside[effect.name] = value
        through_armatures = self._finish_plays(spec, values)
        beside |= {name: value for name, value in values.items() if name not in self._own_by_name}
        said = [f"One transition is {substeps} time steps."]
        said += [self._all_by_name[name].describe(value) + "." for name, value in values.items()]
        said += [f"{name} is written as {value:g}, in whole time steps." for name, value in rounded.items()]
        if through_armatures:
            said.append(
                "Armatures hold the time step times the damping of joints, which flanks of play must know."
            )
        spec.comment = " ".join(said)
        spec.compile()
        files = {target: write_xml(spec).encode()}
        files |= {target.parent / name: content for name, content in self.model.assets.items()}
        return self._write(files, target, beside, rounded, force=force)

    def _kept_commands(self, values: Mapping[str, float]) -> set[str]:
        """Return effects on commands that MJCF could express if nothing that it cannot came after them."""
        behind = {name.partition("[")[2][:-1] for name in values if name.startswith(BEHIND_COMMANDS)}
        kept = {name for one in behind for name in (f"scale[ctrl.{one}]", f"bias[ctrl.{one}]", f"lag[{one}]")}
        # What is common to all lags can only be where each one is.
        lags = {name for name in values if name.startswith("lag[")}
        return kept | (lags if behind and "lag[all]" in values else set())

    def to_urdf(self, path: str | PathLike[str], *, force: bool = False) -> tuple[Path, ...]:
        """Write the URDF that the model was read from, with the effects that are built in.

        Only the elements that an effect changes differ from those of the original: masses, inertias, centres of mass,
        places of joints, damping, friction, effort limits. What a URDF does not say (the time step, delays, armature,
        gains of motors, sensors, contacts) is written beside it, into ``<name>.effects.json``.

        Parameters
        ----------
        path : path
            Where to write it; meshes are meant by the names that the original has for them.
        force : bool, default=False
            Whether to overwrite files that exist.

        Returns
        -------
        tuple of Path
            The files written.

        Raises
        ------
        FileExistsError
            If one of the files exists and `force` is False; nothing is written then.
        FileNotFoundError
            If the folder does not exist.
        ValueError
            If the model was not read from a URDF.
        """
        if self.model.urdf is None:
            raise ValueError("the model was not read from a URDF; write it as MJCF, by to_mjcf")
        target = writable(path, force=force)
        values = self._built_in()
        held = {name: value for name, value in values.items() if self._is_held_by_urdf(name, value)}
        nominal = self._model({}, self.frame_skip)
        text = edited_urdf(self.model.urdf, nominal, self._model(held, self.frame_skip))
        beside = {name: value for name, value in values.items() if name not in held}
        return self._write({target: text.encode()}, target, beside, {}, force=force)

    def _is_held_by_urdf(self, name: str, value: float) -> bool:
        effect = self._own_by_name.get(name)
        if (
            effect is None
            or effect.apply is None
            or effect.family in PREPARED
            or self._is_of_commands(effect)
        ):
            return False
        models = self._model({}, self.frame_skip), self._model({name: value}, self.frame_skip)
        if not set(differing_fields(*models)) <= HELD | DERIVED:
            return False
        # The joint of base="free" is none of the URDF's.
        free = self._nominal.jnt_type[self._nominal.dof_jntid] == FREE
        return all(
            np.array_equal(*(getattr(model, field)[free] for model in models)) for field in HELD_OF_JOINTS
        )

    def _write(
        self,
        files: dict[Path, bytes],
        target: Path,
        beside: Mapping[str, float],
        rounded: Mapping[str, float],
        *,
        force: bool,
    ) -> tuple[Path, ...]:
        """Write the files of a model, and the notes of what they cannot express, all of them or none."""
        notes = writable(target.with_suffix(NOTES), force=force)
        if beside or rounded:
            text = json.dumps(
                self._beside(beside) | ({"written rounded": rounded} if rounded else {}), indent=2
            )
            files = files | {notes: (text + "\n").encode()}
        changed = [file for file, content in files.items() if not _holds(file, content)]
        for file in changed:
            writable(file, force=force)
        with ExitStack() as drafts:
            for file in changed:
                drafts.enter_context(whole(file)).write_bytes(files[file])
        if notes not in files:
            notes.unlink(missing_ok=True)  # of another model that had this name
        return tuple(files)

    def compiled(self, effects: Mapping[str, float] | None = None) -> mujoco.MjModel:
        """Return a compiled model with effects, for example to render it or to look at its numbers.

        Parameters
        ----------
        effects : mapping from name to value, optional
            On top of those that are built in. What the model does not hold here is left out: what MJCF cannot
            express, and what lies between commands and actuators, ``delay``, the model's own among them, ``lag``,
            ``scale[ctrl.<actuator>]`` and ``bias[ctrl.<actuator>]``, which `to_mjcf` writes. A time step is rounded
            up to a whole number of them in a transition.
        """
        values = self._total(effects)
        own = {name: values[name] for name in values if name in self._own_by_name}
        return self._model(own, self._substeps(values)[0][1])

    def prepared(
        self, values: Mapping[str, float], n_substeps: int | None = None
    ) -> tuple[mujoco.MjModel, int, Forces]:
        """Return what it takes to step rows under effects: the compiled model, the substeps, the forces.

        Parameters
        ----------
        values : mapping from name to value
            Checked values of the effects other than those of sensors, the built-in ones included.
        n_substeps : int, optional
            Time steps to run; `frame_skip` by default.
        """
        return self._model(values, self.frame_skip), n_substeps or self.frame_skip, self._forces(values)

    def exerted(self, inputs: Array, groups: Array) -> tuple[Array, Array]:
        """Return the forces of actuators, and of gravity and motion, on each degree of freedom as the simulation is.

        Parameters
        ----------
        inputs : ndarray of shape (n_rows, n_inputs)
            Activations are those that commands held for long leave.
        groups : ndarray of shape (n_rows,)

        Returns
        -------
        actuators, bias : ndarray of shape (n_rows, nv)
            ``qfrc_actuator`` and ``qfrc_bias``, N or N m.
        """
        # No motor is apart from its link where its link alone is seen.
        values = {name: at for name, at in self._built_in().items() if not name.startswith("backlash[")}
        model = self._model(self._physical(values), self.frame_skip)
        n_states, forces = len(self.state_names), np.zeros((2, len(inputs), model.nv))
        (commands,) = self.acting_commands(inputs[:, n_states:], [{}], groups=groups)
        activations = steady_activations(model, commands, inputs[:, : model.nq])
        data = mujoco.MjData(model)
        for row, (state, command, activation) in enumerate(zip(inputs[:, :n_states], commands, activations)):
            data.qpos[:], data.qvel[:] = np.split(state, [model.nq])
            data.ctrl[:], data.act[:] = command, activation
            mujoco.mj_forward(model, data)
            forces[:, row] = data.qfrc_actuator, data.qfrc_bias
        return forces[0], forces[1]

    def acting_commands(
        self,
        commands: ArrayLike,
        candidates: Sequence[Mapping[str, float]],
        *,
        groups: ArrayLike | None = None,
    ) -> Array:
        """Return what reaches the actuators in the mean of each row, under each set of effect values.

        Parameters
        ----------
        commands : array-like of shape (n_rows, nu)
        candidates : sequence of mappings from name to value
        groups : array-like of shape (n_rows,), optional
            As in `predict`.

        Returns
        -------
        ndarray of shape (n_candidates, n_rows, nu)
        """
        sent = np.asarray(commands, dtype=float)
        starts = episode_starts(groups, len(sent))
        totals = [self._physical(self._total(values)) for values in candidates]
        return np.stack(
            [sent if one is None else one[0].mean(axis=1) for one in self._acting(sent, starts, totals)]
        )

    def missing_forces(
        self,
        states: ArrayLike,
        accelerations: ArrayLike,
        commands: Array,
        candidates: Sequence[Mapping[str, float]],
        *,
        slip: ArrayLike = 0.0,
        velocities: ArrayLike | None = None,
    ) -> Array:
        """Return the force that a motion needs beyond what the model exerts, under each set of effect values.

        By inverse dynamics: M a less gravity, inertial forces, springs, dampers, actuators and applied forces.
        Contacts, limits, play and other constraints but dry friction exert nothing here. Dry friction is as soft as
        MuJoCo's: below a speed it grows with it. Motors have no largest force: a servo that is much too stiff in the
        model would be at it where that of the machine never is.

        Parameters
        ----------
        states : array-like of shape (n_rows, n_states)
        accelerations : array-like of shape (n_rows, nv)
            Of the degrees of freedom, in MuJoCo's order.
        commands : ndarray of shape (n_candidates, n_rows, nu)
            What reaches the actuators, as from `acting_commands`.
        candidates : sequence of mappings from name to value
        slip : float or array-like of shape (nv,), default=0
            Standard deviation of the speeds: dry friction is what it is on average within it.
        velocities : array-like of shape (n_rows, n_instants, nv), optional
            Of each row, those over which dry friction is averaged, evenly spaced in time; where a joint turns back
            within a row, that of the mean speed is not the mean. By default that of the states.

        Returns
        -------
        ndarray of shape (n_candidates, n_rows, nv)
            N or N m.
        """
        totals = [self._total(values) for values in candidates]
        seen = np.broadcast_to(np.asarray(states, float), (len(totals), *np.shape(states)))
        inputs = np.concatenate([self._true_inputs(seen, totals), commands], axis=2)
        jobs = []
        for index, total in enumerate(totals):
            values = _without_plays(self._physical(total))
            model = self._unconstrained(values)
            jobs.append(Job(index, model, 1, self._forces(values)))
        stepper = self._cached("stepper", Stepper)
        inputs = self._layout.normalised(inputs, "states")
        forces, friction = stepper.missing_forces(jobs, inputs, np.asarray(accelerations, float))
        speeds = inputs[:, :, self._nominal.nq : self._nominal.nq + self._nominal.nv]
        for job, force, brake, mean in zip(jobs, forces, friction, speeds):
            if not brake.any():
                continue
            softness, damping = creep(job.model)
            seen = mean[:, None] if velocities is None else np.asarray(velocities, float)
            seen = seen + (np.asarray(accelerations, float) / damping)[:, None]
            zone = (brake * softness / damping)[:, None]
            share = braking_share(seen, zone, np.asarray(slip, float))
            # By the trapezoidal rule: rows begin where those before end.
            weights = np.ones(seen.shape[1])
            weights[[0, -1]] = 1 if velocities is None else 0.5
            force += brake * np.average(share, axis=1, weights=weights)
        return forces

    def constrained(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Return in which rows a contact, a limit or another constraint but play pushes, under the model as it is.

        Parameters
        ----------
        states : array-like of shape (n_rows, n_states)

        Returns
        -------
        ndarray of bool of shape (n_rows,)
        """
        states = self._layout.normalised(np.asarray(states, float), "states")
        inputs = np.concatenate([states, np.zeros((len(states), self._nominal.nu))], axis=1)[None]
        values = _without_plays(self._physical(self._built_in()))
        model = self._flagged(values, mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)
        return self._cached("stepper", Stepper).constrained(Job(0, model, 1), inputs)

    def _unconstrained(self, values: Mapping[str, float]) -> mujoco.MjModel:
        return self._flagged(values, mujoco.mjtDisableBit.mjDSBL_CONSTRAINT, limited=False)

    def _flagged(
        self, values: Mapping[str, float], flag: mujoco.mjtDisableBit, *, limited: bool = True
    ) -> mujoco.MjModel:
        """Return the compiled model with a part of MuJoCo's pipeline disabled, and perhaps the limits of its motors."""
        model = self._model(values, self.frame_skip)
        kept: dict[tuple[int, int], tuple[mujoco.MjModel, mujoco.MjModel]]
        kept = self._cached("flagged", dict)
        # By identity, and with the original beside it, so that it stays the one.
        key = id(model), int(flag)
        if key not in kept or kept[key][0] is not model:
            while len(kept) >= 2 * CACHED_MODELS:
                kept.pop(next(iter(kept)))
            changed = copy.copy(model)
            changed.opt.disableflags |= int(flag)
            if not limited:
                for flags in ("actuator_forcelimited", "jnt_actfrclimited", "tendon_actfrclimited"):
                    getattr(changed, flags)[:] = 0
            kept[key] = model, changed
        return kept[key][1]

    def all_effects(self) -> tuple[Effect, ...]:
        """Return every effect that is accepted, also those not listed as causes to choose from."""
        return tuple(self._by_name.values())

    def joint_forces(self) -> tuple[tuple[Effect, tuple[str, ...]], ...]:
        """Return the constant forces on degrees of freedom, and of each the inputs that belong to its joint.

        Returns
        -------
        tuple of (Effect, tuple of str)
            ``force[<joint>]``; position, velocity and, where a motor drives the joint, its control.
        """
        return self._cached("joint_forces", self._joint_forces)

    def _joint_forces(self) -> tuple[tuple[Effect, tuple[str, ...]], ...]:
        tangent, names = self._layout.tangent_names, self._control_names()
        found = []
        for dof, name in enumerate(self._listing.forces):
            position = tangent[dof]
            if position not in self.state_names:  # of a rotation vector: the same axis of the quaternion
                position = position[: -len("rx")] + "q" + position[-1]
            controls = [names[actuator] for actuator in self._anatomy.drives[dof]]
            velocity = tangent[self._nominal.nv + dof]
            found.append((self._by_name[name], (position, velocity, *controls)))
        return tuple(found)

    def parts(self) -> tuple[tuple[str, ...], ...]:
        """Return the channels of a residual, part by part: trees of bodies that move each other.

        All are of one part where `extra_effects` may do anything.
        """
        return self._cached("parts", self._parts)

    def _parts(self) -> tuple[tuple[str, ...], ...]:
        of_dofs = np.tile(self._dof_parts, 2)
        names = np.array(self.residual_names)
        return tuple(
            tuple(names[of_dofs == part].tolist()) for part in range(int(of_dofs.max(initial=0)) + 1)
        )

    def part_of(self, effect: str) -> int | None:
        """Return the part that an effect, by its name, acts in alone; None where it may act in several."""
        return self._cached("places", self._places).get(effect)

    def _places(self) -> dict[str, int]:
        if self.extra_effects:
            return {}
        forces = zip(self._listing.forces, self._dof_parts.tolist())
        return {**places_of_effects(self._anatomy, self._dof_parts), **dict(forces)}

    @property
    def _dof_parts(self) -> NDArray[np.intp]:
        if self.extra_effects:
            return np.zeros(self._nominal.nv, dtype=int)
        return self._cached("dof_parts", lambda: parts_of(self._anatomy))

    def _own_effects(self) -> tuple[Effect, ...]:
        return (*self._listing.effects, *self.extra_effects)

    def _unlisted_effects(self) -> frozenset[str]:
        return self._listing.unlisted

    def _asked_effects(self) -> frozenset[str]:
        return super()._asked_effects() | self._listing.asked

    def _sensor_effects(self) -> tuple[Effect, ...]:
        return self._cached("sensors", lambda: tuple(_sensor_effects(self._layout, self.dt)))

    def _lags(self, values: Mapping[str, float]) -> int:
        path = self._path(values)
        return max(path.n_lags(self.dt, n_substeps) for _, n_substeps in self._substeps(values))

    def _path(self, values: Mapping[str, float]) -> CommandPath:
        """Return what lies between the commands and the actuators."""
        names, nu = self._actuator_names, self._nominal.nu
        scale, bias, delay, lag, dead_zone = (
            np.array([values.get(f"{family}[{name}]", neutral) for name in targets])
            for family, targets, neutral in (
                ("scale", [f"ctrl.{name}" for name in names], 1.0),
                ("bias", [f"ctrl.{name}" for name in names], 0.0),
                ("delay", names, 0.0),
                ("lag", names, 0.0),
                ("dead_zone", names, 0.0),
            )
        )
        own_delay, holds = self._native_delays
        late = self._anatomy.model.actuator_dyntype == NO_DYNAMICS
        return CommandPath(
            scale=scale,
            bias=bias,
            held=np.where(holds, own_delay, 0.0),
            delay=delay + np.where(holds, 0.0, own_delay) + values.get("delay[action]", 0.0),
            lag=lag + np.where(late, values.get("lag[all]", 0.0), 0.0),
            dead_zone=np.where(self._follows_places, 0.0, dead_zone) if nu else dead_zone,
        )

    @property
    def _actuator_names(self) -> tuple[str, ...]:
        return tuple(name.removeprefix("ctrl.") for name in self._cached("controls", self._control_names))

    @property
    def _feeds_back(self) -> NDArray[np.bool_]:
        """Whether each actuator's force depends on the place of what it moves."""
        feeds_back: NDArray[np.bool_] = self._nominal.actuator_biasprm[:, 1] != 0
        return feeds_back

    @property
    def _follows_places(self) -> NDArray[np.bool_]:
        """Whether each actuator's control is a place of what it moves, and no rate that it integrates."""
        follows: NDArray[np.bool_] = self._feeds_back & (self._nominal.actuator_dyntype != INTEGRATOR)
        return follows

    @property
    def _native_delays(self) -> tuple[Array, NDArray[np.bool_]]:
        """The delay of each actuator in the model, s, and whether a late control is held between time steps."""

        def found() -> tuple[Array, NDArray[np.bool_]]:
            actuators = self.model.spec().actuators
            delays = [one.delay if one.nsample else 0.0 for one in actuators]
            holds = [delay > 0 and one.interp == 0 for one, delay in zip(actuators, delays)]
            return np.array(delays, dtype=float), np.array(holds, dtype=bool)

        return self._cached("native_delays", found)

    def _acting(
        self, actions: Array, starts: NDArray[np.intp], candidates: Sequence[Mapping[str, float]]
    ) -> list[Acting]:
        found: list[Acting] = []
        for values in candidates:
            path = self._path(values)
            numbers = [n_substeps for _, n_substeps in self._substeps(values)]
            within = (
                path.acting(actions, starts, self.dt, n_substeps, self._command_range(values, n_substeps))
                for n_substeps in numbers
            )
            found.append(tuple(within) if path.changes else None)
        return found

    def _command_range(self, values: Mapping[str, float], n_substeps: int) -> tuple[Array, Array]:
        """Return the lower and the upper ends of the range of each actuator's control."""
        model = self._model(values, n_substeps)
        limited = model.actuator_ctrllimited & (not self._anatomy.is_off("clampctrl"))
        low, high = np.where(limited, model.actuator_ctrlrange.T, [[-np.inf], [np.inf]])
        return low, high

    def _own_hidden_names(self, values: Mapping[str, float]) -> tuple[str, ...]:
        key = "hidden", tuple(name for name in values if name.startswith(("lag_torque[", "backlash[")))
        return self._cached(key, lambda: tuple(self._hidden_names(values)))

    def _hidden_names(self, values: Mapping[str, float]) -> Iterator[str]:
        model = self._nominal
        for name, count in zip(self._actuator_names, model.actuator_actnum):
            yield from (f"act.{name}{number or ''}" for number in range(max(int(count), 0)))
        lags, plays = (
            [name.partition("[")[2][:-1] for name in self._own_by_name if name in values and kind in name]
            for kind in ("lag_torque[", "backlash[")
        )
        yield from (f"torque.{name}" for name in self._actuator_names if name in lags)
        for name in (joint_name(model, joint) for joint in range(model.njnt)):
            if name in plays:
                yield from (f"play.{name}", f"play_rate.{name}")

    def _outputs(
        self,
        inputs: Array,
        candidates: Sequence[Mapping[str, float]],
        acting: Sequence[Acting],
        hidden: Sequence[Array] | None,
        forces: Array | None = None,
    ) -> tuple[Array, list[Array]]:
        inputs = self._layout.normalised(inputs, "X")
        jobs, shares = self._jobs(candidates, acting, hidden)
        states, left = self._cached("stepper", Stepper).run(jobs, inputs, forces)
        return self._mixed(jobs, shares, states, left, inputs)

    def _courses(
        self,
        inputs: Array,
        candidates: Sequence[Mapping[str, float]],
        acting: Sequence[Acting],
        hidden: Sequence[Array] | None,
        forces: Array | None = None,
    ) -> tuple[Array, list[Array], list[Courses]]:
        inputs = self._layout.normalised(inputs, "X")
        jobs, shares = self._jobs(candidates, acting, hidden)
        found, left = self._cached("stepper", Stepper).courses(jobs, inputs, forces)
        outputs, after = self._mixed(jobs, shares, np.stack([one[-1] for one in found]), left, inputs)
        courses: list[Courses] = [[] for _ in candidates]
        for job, share, course in zip(jobs, shares, found):
            courses[job.candidate].append((share, course))
        return outputs, after, courses

    def _jobs(
        self,
        candidates: Sequence[Mapping[str, float]],
        acting: Sequence[Acting],
        hidden: Sequence[Array] | None,
    ) -> tuple[list[Job], list[float]]:
        """Return what is to be run for each candidate, and the share of each in its result; see `_substeps`."""
        jobs: list[Job] = []
        shares: list[float] = []
        for index, values in enumerate(candidates):
            for part, (share, n_substeps) in enumerate(self._substeps(values)):
                controls = acting[index]
                model = self._model(values, n_substeps)
                plays = self._plays(values, model)
                job = Job(
                    index,
                    model,
                    n_substeps,
                    self._forces(values, plays),
                    None if controls is None else controls[part],
                    plays,
                    None if hidden is None else hidden[index],
                )
                jobs.append(job)
                shares.append(share)
        return jobs, shares

    def _mixed(
        self,
        jobs: Sequence[Job],
        shares: Sequence[float],
        states: Array,
        left: Sequence[Array],
        inputs: Array,
    ) -> tuple[Array, list[Array]]:
        """Return the outputs and hidden states of candidates, of one job or two each."""
        outputs = np.empty((jobs[-1].candidate + 1, *states.shape[1:]))
        after: list[Array] = [np.empty(0)] * len(outputs)
        for job, share, result, rest in zip(jobs, shares, states, left):
            if share == 1.0:
                outputs[job.candidate], after[job.candidate] = result, rest
            else:  # the second of two jobs: between the first's result and its own
                step = self._layout.difference(result, outputs[job.candidate])
                outputs[job.candidate] = self._layout.displaced(outputs[job.candidate], share * step)
                after[job.candidate] += share * (rest - after[job.candidate])
        return self._layout.aligned(outputs, inputs[..., : len(self.state_names)]), after

    def _plays(self, values: Mapping[str, float], model: mujoco.MjModel) -> tuple[Play, ...]:
        """Return where a model with plays has them."""
        found = []
        for name, width in values.items():
            if name.startswith("backlash["):
                joint = name.partition("[")[2][:-1]
                motor, link = model.joint(joint), model.joint(joint + PLAY)
                columns = (int(motor.qposadr[0]), int(motor.dofadr[0]), int(link.qposadr[0]))
                found.append(Play(*columns, int(link.dofadr[0]), width))
        return tuple(sorted(found, key=lambda play: play.play))

    def coarsely(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return values with the finest time step that is run in the place of one that is extrapolated.

        Not with a coarser one: in that a stiff servo moves in another way.
        """
        finest = 1 / MOST_STEPS
        return {name: max(one, finest) if name == "timestep" else one for name, one in values.items()}

    def _substeps(self, values: Mapping[str, float]) -> list[tuple[float, int]]:
        """Return the numbers of time steps per transition to run, each with its share in the result.

        Between whole numbers the result is interpolated, so that it is continuous in the time step. Of steps finer than
        are run it is extrapolated from those and from twice as long ones, by the order of the integrator.
        """
        exact, most = self.frame_skip / values.get("timestep", 1.0), MOST_STEPS * self.frame_skip
        if exact > most:
            few, order = math.ceil(most / 2), 4 if self._nominal.opt.integrator == RUNGE_KUTTA else 1
            wanted, fine, coarse = (steps**-order for steps in (exact, most, few))
            return [(1.0, most), ((wanted - fine) / (coarse - fine), few)]
        if abs(exact - round(exact)) < 1e-9:
            return [(1.0, round(exact))]
        return [(1.0, math.floor(exact)), (exact - math.floor(exact), math.ceil(exact))]

    def _forces(self, values: Mapping[str, float], plays: tuple[Play, ...] = ()) -> Forces:
        anatomy, nominal = self._anatomy, self._nominal
        families = {name.partition("[")[0] for name in values}
        if not families & {*STEPPED, *NEUTRAL}:
            return Forces(anatomy.root)
        size = nominal.nv + len(plays)
        seen = [dof for dof in range(size) if dof not in {play.play_dof for play in plays}]
        places = [one for one in range(nominal.nq + len(plays)) if one not in {play.play for play in plays}]
        dofs = {name: dof for dof, name in enumerate(self._listing.forces)}
        friction = []
        for joint in range(nominal.njnt) if families & set(NEUTRAL) else ():
            name = joint_name(nominal, joint)
            law = {family: values[f"{family}[{name}]"] for family in NEUTRAL if f"{family}[{name}]" in values}
            if law:
                at = seen[int(nominal.jnt_dofadr[joint])], places[int(nominal.jnt_qposadr[joint])]
                friction.append((*at, tuple((NEUTRAL | law).values())))
        by_actuator = {
            family: [
                (index, values[f"{family}[{name}]"])
                for index, name in enumerate(self._actuator_names)
                if f"{family}[{name}]" in values
            ]
            for family in ("dead_zone", "torque_speed", "lag_torque")
        }
        follows_places = self._follows_places
        return Forces(
            body=anatomy.root,
            wind=tuple(values.get(f"wind[{axis}]", 0.0) for axis in "xyz"),  # type: ignore[arg-type]
            drag=tuple(self._outside(values, f"air_drag[{axis}]") for axis in "xyz"),  # type: ignore[arg-type]
            drag_all=self._outside(values, "air_drag[all]"),
            joints=tuple((seen[dofs[name]], values[name]) for name in dofs if name in values),
            friction=tuple(friction),
            dead_zones=tuple(
                (index, width) for index, width in by_actuator["dead_zone"] if follows_places[index]
            ),
            speed_slopes=tuple(by_actuator["torque_speed"]),
            torque_lags=tuple(by_actuator["lag_torque"]),
        )

    def _outside(self, values: Mapping[str, float], name: str) -> float:
        """Return the value of an effect that no edit of the model expresses; 0 of any other."""
        known = self._own_by_name.get(name)
        return values.get(name, 0.0) if known is not None and known.apply is None else 0.0

    def _edited(self, values: Mapping[str, float]) -> list[tuple[Effect, Callable[[Any, float], None]]]:
        """Return the effects that edit the model, in their order, with their edits."""
        found = []
        for effect in self._edit_order(values):
            if effect.family == "payload" and effect.unit == "kg":
                found.append((effect, self._payload_edit(str(effect.target), values)))
            elif effect.apply is not None:
                found.append((effect, effect.apply))
        return found

    def _payload_edit(self, body: str, values: Mapping[str, float]) -> Callable[[Any, float], None]:
        place = tuple(values.get(f"payload[{body}.{axis}]") for axis in "xyz")
        numbers = {self._anatomy.body_name(one): one for one in range(self._nominal.nbody)}
        return partial(add_payload, numbers[body], place)

    def payload_places(self, body: str, *, per_axis: int = 3) -> Array:
        """Return places where a weight may be fixed to a body: a grid over the box about its geoms.

        A point mass m at the place r acts through its four linear moments, (m, m r), and the inertia of a point; what
        screens payloads tries these places, and refines the best by ``payload[body.x|y|z]``.

        Parameters
        ----------
        body : str
        per_axis : int, default=3
            Places along each side of the box, its faces included.

        Returns
        -------
        ndarray of shape (per_axis ** 3, 3)
            In the body's frame, m.

        Raises
        ------
        ValueError
            If no body of this name can carry a payload.
        """
        names = [f"payload[{body}.{axis}]" for axis in "xyz"]
        if not all(name in self._by_name for name in names):
            there = [
                one.target
                for one in self._by_name.values()
                if one.name.startswith("payload[") and one.unit == "kg"
            ]
            raise ValueError(f"no payload can be on {body!r}; bodies: {', '.join(map(str, there))}")
        sides = [np.linspace(*self._all_by_name[name].bounds, per_axis) for name in names]
        return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)

    def _model(self, values: Mapping[str, float], n_substeps: int) -> mujoco.MjModel:
        """Return the model with the effects that edit it, compiled."""
        edited = [pair for pair in self._edited(values) if not self._is_of_commands(pair[0])]
        cache: OrderedDict[tuple[Any, ...], mujoco.MjModel] = self._cached("models", OrderedDict)
        places = tuple((name, values[name]) for name in values if name.startswith("payload["))
        key = (n_substeps, places, *((effect.name, values[effect.name]) for effect, _ in edited))
        if key not in cache:
            spec = self._spec.copy()
            for effect, edit in edited:
                edit(spec, values[effect.name])
            if n_substeps != self.frame_skip:
                spec.option.timestep = spec.option.timestep * self.frame_skip / n_substeps
            self._finish_plays(spec, values)
            try:
                cache[key] = compile_spec(spec)
            except ValueError as error:
                raise broken_model(f"the model with the effects {dict(values)}", error) from None
            if len(cache) > CACHED_MODELS:
                cache.popitem(last=False)
        cache.move_to_end(key)
        return cache[key]

    def _finish_plays(self, spec: mujoco.MjSpec, values: Mapping[str, float]) -> bool:
        joints, lags = (
            {name.partition("[")[2][:-1]: values[name] for name in values if name.startswith(family)}
            for family in ("backlash[", "lag_torque[")
        )
        if not joints:
            return False
        late = {name: spec.option.timestep / lag for name, lag in lags.items() if lag > 0}
        # Of a constant input a filter passes so much, in the mean over a time step.
        shares = {self._actuator_names.index(name): 1 + math.expm1(-x) / x for name, x in late.items()}
        return finish_plays(joints, spec, shares)

    def _is_of_commands(self, effect: Effect) -> bool:
        """Whether an effect's edit is for written models only: here the commands, or the time steps, are changed."""
        on_command = effect.family in ("bias", "scale") and str(effect.target).startswith("ctrl.")
        return effect.family in {"timestep", "delay", "lag"} or on_command

    def _edit_order(self, values: Mapping[str, float]) -> list[Effect]:
        return self._cached(
            ("order", tuple(values)),
            lambda: sorted(
                (effect for effect in self._own_effects() if effect.name in values),
                key=lambda effect: FAMILIES[effect.family].order if effect.family in FAMILIES else 0,
            ),
        )

    def _beside(self, values: Mapping[str, float]) -> dict[str, Any]:
        effects = [
            {
                "name": name,
                "value": value,
                "unit": self._all_by_name[name].unit,
                "meaning": self._all_by_name[name].describe(value),
            }
            for name, value in values.items()
        ]
        return {
            "about": "Effects that belong to the model beside this file and that MJCF cannot express.",
            "wind and drag act on body": self._anatomy.body_name(self._anatomy.root),
            "effects": effects,
        }

    def _control_names(self) -> tuple[str, ...]:
        return tuple(f"ctrl.{actuator_name(self._nominal, index)}" for index in range(self._nominal.nu))

    @property
    def _spec(self) -> mujoco.MjSpec:
        """The model as a spec, without what only the eye needs."""
        return self._cached("spec", lambda: lean_spec(self.model))

    @property
    def _nominal(self) -> mujoco.MjModel:
        return self._cached("nominal", lambda: checked_model(self._spec, self.frame_skip))

    @property
    def _nominal_name(self) -> str:
        return str(self._spec.modelname)

    @property
    def _layout(self) -> StateLayout:
        return self._cached("layout", lambda: state_layout(self._nominal))

    @property
    def _anatomy(self) -> Anatomy:
        return self._cached("anatomy", lambda: Anatomy(self._nominal))

    @property
    def _listing(self) -> Listing:
        return self._cached("listing", self._checked_listing)

    def _checked_listing(self) -> Listing:
        listing = effect_listing(self._anatomy, self.frame_skip)
        taken = {effect.name for effect in listing.effects} & {effect.name for effect in self.extra_effects}
        if taken:
            raise ValueError(
                f"extra_effects names {', '.join(sorted(taken))}; the model has effects of these names, choose others"
            )
        reserved = sorted(effect.name for effect in self.extra_effects if effect.family in RESERVED)
        if reserved:
            raise ValueError(
                f"extra_effects names {', '.join(reserved)}; what the families {', '.join(RESERVED)} do is no edit of "
                "the model: choose another family"
            )
        return listing

    @property
    def _own_by_name(self) -> dict[str, Effect]:
        return self._cached("own_by_name", lambda: {effect.name: effect for effect in self._own_effects()})


def _holds(file: Path, content: bytes) -> bool:
    return file.is_file() and file.read_bytes() == content


def _without_plays(values: Mapping[str, float]) -> dict[str, float]:
    """Return values for inverse dynamics: the forces that a motion needs go through the gear on either flank."""
    return {name: value for name, value in values.items() if not name.startswith("backlash[")}


def _sensor_effects(layout: StateLayout, dt: float) -> list[Effect]:
    quaternion_columns = {column + part for column, _ in layout.quaternions for part in range(4)}
    limits = {"m": 10.0, "rad": math.pi, "m/s": 10.0, "rad/s": 10.0}
    channels = [
        (name, unit)
        for column, (name, unit) in enumerate(zip(layout.names, layout.units))
        if column not in quaternion_columns
    ]
    biases = [
        Effect(f"bias[{name}]", unit=unit, neutral=0.0, bounds=(-limits[unit], limits[unit]))
        for name, unit in channels
    ]
    scales = [Effect(f"scale[{name}]", unit="1", neutral=1.0, bounds=(0.1, 10.0)) for name, _ in channels]
    return biases + scales + list(sensor_lags([name for name, _ in channels], dt))
