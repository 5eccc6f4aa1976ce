"""Any MuJoCo model as a simulator: rows of [qpos, qvel, ctrl] in, rows of the next [qpos, qvel] out."""

import json
import math
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from os import PathLike
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from skat.effects import Effect
from skat.files import whole, writable
from skat.simulators.anatomy import EXPLICIT_INTEGRATOR, Anatomy, actuator_name
from skat.simulators.base import Simulator
from skat.simulators.catalogue import Listing, effect_listing
from skat.simulators.channels import HINGE, StateLayout, joint_name, state_layout
from skat.simulators.compiling import checked_model, compile_spec, lean_spec
from skat.simulators.derived import write_down
from skat.simulators.furnishing import with_base, with_motors
from skat.simulators.source import (
    NOTES,
    ModelSource,
    broken_model,
    differing_fields,
    read_source,
    write_xml,
)
from skat.simulators.stepping import Forces, Job, Stepper, delayed_controls
from skat.simulators.tables import Array
from skat.simulators.urdf import DERIVED, HELD, edited_urdf

CACHED_MODELS = 256
# Edits that need the outcome of others come last.
LAST = (
    "radius",
    "inertia",
    "centre_of_mass",
    "contact_friction",
    "contact_anisotropy",
    "restitution",
    "delay",
)


class MujocoSimulator(Simulator):
    """A MuJoCo model as a simulator.

    X = [qpos, qvel, ctrl], y = [qpos, qvel] after ``frame_skip`` time steps.

    Every row starts from a clean state: time zero, no warm start of the constraint solver. All rows, under
    all candidate effects, run in one call of ``mujoco.batch``.

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
        If MuJoCo cannot read the model; if it has actuators with activation states or delays, whose state
        the rows do not hold; if an extra effect has the name of another one.

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
        model: str | PathLike | mujoco.MjSpec | mujoco.MjModel | ModelSource,
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
    def dt(self) -> float:  # type: ignore[override]
        """Duration of a transition, s."""
        return self.frame_skip * float(self._nominal.opt.timestep)

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

    def _reads_delayed(self, spec: mujoco.MjSpec, delay: float, values: Mapping[str, float]) -> bool:
        """Whether MuJoCo delays controls as this simulator does: between time steps, by one of them at least."""
        step = float(self._nominal.opt.timestep) * max(1.0, values.get("timestep", 1.0))
        return int(spec.option.integrator) != EXPLICIT_INTEGRATOR and delay >= step

    def to_mjcf(self, path: str | PathLike, *, force: bool = False) -> tuple[Path, ...]:
        """Write the model, with the effects that are built in, for any user of MuJoCo.

        Numbers are written with all digits: plain MuJoCo predicts what this simulator predicts. A time step that does
        not divide a transition is written as the nearest one that does; the notes beside the model say so. What MJCF
        cannot express (wind, drag on bodies that turn, friction that grows with the position, forces on joints,
        sensors, a delay shorter than a time step, and any under the Runge-Kutta integrator, which reads delayed
        controls between time steps) is written beside it, into ``<name>.effects.json``.

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
        substeps, beside, rounded = self.frame_skip, {}, {}
        for effect in self._edit_order(values):
            value = values[effect.name]
            if effect.family == "timestep":
                substeps = round(self.frame_skip / value) or 1
                written = self.frame_skip / substeps
                if len(self._substeps(values)) > 1:
                    rounded[effect.name] = written
                effect.apply(spec, written)  # type: ignore[misc]
            elif effect.apply is None or (
                effect.family == "delay" and not self._reads_delayed(spec, value, values)
            ):
                beside[effect.name] = value
            else:
                effect.apply(spec, value)
        beside |= {name: value for name, value in values.items() if name not in self._own_by_name}
        said = [f"One transition is {substeps} time steps."]
        said += [self._all_by_name[name].describe(value) + "." for name, value in values.items()]
        said += [f"{name} is written as {value:g}, in whole time steps." for name, value in rounded.items()]
        spec.comment = " ".join(said)
        spec.compile()
        files = {target: write_xml(spec).encode()}
        files |= {target.parent / name: content for name, content in self.model.assets.items()}
        return self._write(files, target, beside, rounded, force=force)

    def to_urdf(self, path: str | PathLike, *, force: bool = False) -> tuple[Path, ...]:
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
        if effect is None or effect.apply is None or effect.family in {"timestep", "delay"}:
            return False
        models = self._model({}, self.frame_skip), self._model({name: value}, self.frame_skip)
        return set(differing_fields(*models)) <= HELD | DERIVED

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
            On top of those that are built in. Those that MJCF cannot express are left out; a time step is
            rounded up to a whole number of them in a transition.
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

    def _own_effects(self) -> tuple[Effect, ...]:
        return (*self._listing.effects, *self.extra_effects)

    def _unlisted_effects(self) -> frozenset[str]:
        return self._listing.unlisted

    def _sensor_effects(self) -> tuple[Effect, ...]:
        return self._cached("sensors", lambda: tuple(_sensor_effects(self._layout)))

    def _lags(self, values: Mapping[str, float]) -> int:
        return math.ceil(values.get("delay[action]", 0.0) / self.dt - 1e-9)

    def _outputs(
        self, inputs: Array, candidates: Sequence[Mapping[str, float]], history: Array | None
    ) -> Array:
        inputs = self._layout.normalised(inputs, "X")
        n_states = len(self.state_names)
        jobs: list[Job] = []
        shares: list[float] = []
        for index, values in enumerate(candidates):
            for share, n_substeps in self._substeps(values):
                controls = None
                if values.get("delay[action]"):
                    lag = values["delay[action]"] * n_substeps / self.dt
                    controls = delayed_controls(inputs[index, :, n_states:], history, lag, n_substeps)
                model = self._model(values, n_substeps)
                jobs.append(Job(index, model, n_substeps, self._forces(values), controls))
                shares.append(share)
        states = self._cached("stepper", Stepper).run(jobs, inputs)
        outputs = np.empty((len(candidates), *states.shape[1:]))
        for job, share, result in zip(jobs, shares, states):
            if share == 1.0:
                outputs[job.candidate] = result
            else:  # the second of two jobs: between the first's result and its own
                step = self._layout.difference(result, outputs[job.candidate])
                outputs[job.candidate] = self._layout.displaced(outputs[job.candidate], share * step)
        return self._layout.aligned(outputs, inputs[..., :n_states])

    def _substeps(self, values: Mapping[str, float]) -> list[tuple[float, int]]:
        """Return the numbers of time steps per transition to run, each with its share in the result.

        Between whole numbers the result is interpolated, so that it is continuous in the time step.
        """
        exact = self.frame_skip / values.get("timestep", 1.0)
        if abs(exact - round(exact)) < 1e-9:
            return [(1.0, round(exact))]
        return [(1.0, math.floor(exact)), (exact - math.floor(exact), math.ceil(exact))]

    def _forces(self, values: Mapping[str, float]) -> Forces:
        anatomy, model = self._anatomy, self._nominal
        outside = {name: values[name] for name in values if self._own_by_name[name].apply is None}
        if not outside:
            return Forces(anatomy.root)
        joints = {joint_name(model, joint): joint for joint in range(model.njnt)}
        dofs = {name: dof for dof, name in enumerate(self._listing.forces)}
        friction = []
        for name, value in outside.items():
            if name.startswith("position_friction["):
                joint = joints[str(self._own_by_name[name].target)]
                friction.append((int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint]), value))
        return Forces(
            body=anatomy.root,
            wind=tuple(outside.get(f"wind[{axis}]", 0.0) for axis in "xyz"),  # type: ignore[arg-type]
            drag=tuple(outside.get(f"air_drag[{axis}]", 0.0) for axis in "xyz"),  # type: ignore[arg-type]
            drag_all=outside.get("air_drag[all]", 0.0),
            position_friction=tuple(friction),
            joints=tuple((dofs[name], outside[name]) for name in dofs if name in outside),
        )

    def _model(self, values: Mapping[str, float], n_substeps: int) -> mujoco.MjModel:
        """Return the model with the effects that edit it, compiled."""
        edited = [effect for effect in self._edit_order(values) if effect.family not in {"timestep", "delay"}]
        edited = [effect for effect in edited if effect.apply is not None]
        cache: OrderedDict[tuple, mujoco.MjModel] = self._cached("models", OrderedDict)
        key = (n_substeps, *((effect.name, values[effect.name]) for effect in edited))
        if key not in cache:
            spec = self._spec.copy()
            for effect in edited:
                effect.apply(spec, values[effect.name])  # type: ignore[misc]
            if n_substeps != self.frame_skip:
                spec.option.timestep = spec.option.timestep * self.frame_skip / n_substeps
            try:
                cache[key] = compile_spec(spec)
            except ValueError as error:
                raise broken_model(f"the model with the effects {dict(values)}", error) from None
            if len(cache) > CACHED_MODELS:
                cache.popitem(last=False)
        cache.move_to_end(key)
        return cache[key]

    def _edit_order(self, values: Mapping[str, float]) -> list[Effect]:
        return self._cached(
            ("order", tuple(values)),
            lambda: sorted(
                (effect for effect in self._own_effects() if effect.name in values),
                key=lambda effect: LAST.index(effect.family) + 1 if effect.family in LAST else 0,
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
        return self._spec.modelname

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
        return listing

    @property
    def _own_by_name(self) -> dict[str, Effect]:
        return self._cached("own_by_name", lambda: {effect.name: effect for effect in self._own_effects()})


def _holds(file: Path, content: bytes) -> bool:
    return file.is_file() and file.read_bytes() == content


def _sensor_effects(layout: StateLayout) -> list[Effect]:
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
    return biases + [
        Effect(f"scale[{name}]", unit="1", neutral=1.0, bounds=(0.1, 10.0)) for name, _ in channels
    ]
