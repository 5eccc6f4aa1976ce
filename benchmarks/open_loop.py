"""Open loop and least squares in plain MuJoCo and SciPy, beside what a diagnosis finds: nothing of skat is in here.

A log is cut into stretches, each of which begins at a measured state and goes on with commands alone. Least squares
are given a list of parameters; `sysid` gives the same list and stretches to ``mujoco.sysid``.
"""

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout
from scipy import optimize


@dataclass(frozen=True)
class Stretch:
    """A piece of a log.

    ``qpos`` and ``qvel`` are the state it begins with, rad and rad/s; ``commands`` of shape (n_rows, n_actuators) act
    from row to row; ``after`` of shape (n_rows, n_joints) holds the angles behind each row, rad.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    commands: np.ndarray
    after: np.ndarray


@dataclass(frozen=True)
class Parameter:
    """A number that least squares may choose: how it is written into a spec, or None for a delay of all commands, s.

    ``reach`` holds the places of the joints that it can move, where these are not all.
    """

    name: str
    start: float
    low: float
    high: float
    scale: float
    write: Callable[[mujoco.MjSpec, float], None] | None
    reach: tuple[int, ...] = ()


def stretches_of(X, y, groups, n_joints, n_rows=None, dt=None):
    """Return the stretches of rows ``[qpos, qvel, ctrl]`` and what follows, of ``n_rows`` each without a shorter rest.

    Where speeds were not measured, a stretch begins with the slope of its first five angles, which takes ``dt``, s.
    """
    found = []
    for one in dict.fromkeys(groups.tolist()):
        rows = np.flatnonzero(groups == one)
        length = len(rows) if n_rows is None else n_rows
        for first in range(0, len(rows) - length + 1, length):
            mine = rows[first : first + length]
            speeds = X[mine[0], n_joints : 2 * n_joints]
            if np.isnan(speeds).any():
                speeds = np.polyfit(dt * np.arange(5), X[mine[:5], :n_joints], 1)[0]
            found.append(Stretch(X[mine[0], :n_joints], speeds, X[mine, 2 * n_joints :], y[mine, :n_joints]))
    return found


def late(commands, frame_skip, delay):
    """Return commands at each time step, ``delay`` time steps late, on average over it; before, the first one holds."""
    held = np.repeat(commands, frame_skip, axis=0)
    whole = int(np.floor(delay))
    part = delay - whole
    padded = np.concatenate([np.repeat(held[:1], whole + 1, axis=0), held])[: len(held) + 1]
    return (1 - part) * padded[1:] + part * padded[:-1]


def paths(models, delays, stretches, frame_skip):
    """Return angles behind each row, of shape (n_models, n_stretches, n_rows, n_joints): all stretches of one length.

    ``delays`` holds one delay a model, s.
    """
    data = mujoco.MjData(models[0])
    states, controls = [], []
    for model, delay in zip(models, delays, strict=True):
        for one in stretches:
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = one.qpos, one.qvel
            state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
            mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
            states.append(state)
            controls.append(late(one.commands, frame_skip, delay / model.opt.timestep))
    every = [model for model in models for _ in stretches]
    found, _ = rollout.rollout(every, [data], np.array(states), np.array(controls))
    nq = models[0].nq
    angles = found[:, frame_skip - 1 :: frame_skip, 1 : 1 + nq]
    return angles.reshape(len(models), len(stretches), -1, nq)


def by_length(stretches):
    """Return lists of stretches that are equally long."""
    lengths = dict.fromkeys(len(one.commands) for one in stretches)
    return [[one for one in stretches if len(one.commands) == length] for length in lengths]


def misses(models, delays, stretches, frame_skip):
    """Return simulated less measured angles, one row a model, all stretches behind each other, rad."""
    found = [
        (paths(models, delays, some, frame_skip) - [one.after for one in some]).reshape(len(models), -1)
        for some in by_length(stretches)
    ]
    return np.concatenate(found, axis=1)


def rms(errors):
    """Return the root of the mean square, and infinity where a path has left all bounds."""
    return float(np.sqrt(np.mean(np.square(errors)))) if np.isfinite(errors).all() else float("inf")


def compiled(mjcf, parameters, values):
    """Return the model with values written into it, and the delay, s."""
    spec, delay = mujoco.MjSpec.from_string(mjcf), 0.0
    for parameter, value in zip(parameters, values, strict=True):
        if parameter.write is None:
            delay = float(value)
        else:
            parameter.write(spec, float(value))
    return spec.compile(), delay


def apart(parameters, n_joints):
    """Return sets of places of parameters, no two in a set moving the same joint, so that one simulation serves all."""
    sets, taken = [], []
    for place, parameter in enumerate(parameters):
        reach = set(parameter.reach or range(n_joints))
        free = next((k for k, joints in enumerate(taken) if not joints & reach), None)
        if free is None:
            sets.append([place])
            taken.append(reach)
        else:
            sets[free].append(place)
            taken[free] |= reach
    return sets


def least_squares(mjcf, parameters, stretches, frame_skip, *, most=30, seconds=float("inf")):
    """Return values of the parameters with the least squared misses over the stretches, and the seconds it took.

    Trust region with bounds (`scipy.optimize.least_squares`); slopes are differences of a hundredth of each scale. A
    path that leaves all bounds counts as a miss of 10 rad. Ends after ``most`` evaluations, or the seconds given.
    """
    begun = time.perf_counter()
    scales = np.array([one.scale for one in parameters])
    low, high = np.array([(one.low, one.high) for one in parameters]).T

    def residuals(many):
        models, delays = zip(*(compiled(mjcf, parameters, values) for values in many))
        found = misses(models, delays, stretches, frame_skip)
        return np.clip(np.where(np.isfinite(found), found, 10.0), -10.0, 10.0)

    n_joints = len(stretches[0].qpos)
    sets = apart(parameters, n_joints)

    def slopes(values):
        steps = np.where(values + 0.01 * scales > high, -0.01, 0.01) * scales
        moved = [values + np.where(np.isin(np.arange(len(values)), mine), steps, 0.0) for mine in sets]
        found = residuals([values, *moved])
        columns = np.zeros((len(values), found.shape[1]))
        for difference, mine in zip(found[1:] - found[0], sets, strict=True):
            for place in mine:
                reached = np.isin(np.arange(n_joints), parameters[place].reach or np.arange(n_joints))
                columns[place] = np.where(np.tile(reached, len(difference) // n_joints), difference, 0.0)
        return (columns / steps[:, None]).T

    best = [np.inf, None]

    def one(values):
        if time.perf_counter() - begun > seconds:
            raise TimeoutError
        found = residuals([values])[0]
        if found @ found < best[0]:
            best[:] = [found @ found, values.copy()]
        return found

    start = np.clip([one.start for one in parameters], low + 1e-9 * scales, high - 1e-9 * scales)
    with contextlib.suppress(TimeoutError):
        optimize.least_squares(
            one, start, slopes, bounds=(low, high), x_scale=scales, max_nfev=most, ftol=1e-6, xtol=1e-8
        )
    return best[1], time.perf_counter() - begun


def sysid(mjcf, parameters, stretches, frame_skip, *, seconds=600.0):
    """Return values, half widths of 95 % intervals (None where it was cut off) and seconds of ``mujoco.sysid``.

    It is ended after so many seconds, with the best values so far. It knows no delay that it could fit, so such a
    parameter is left out.
    """
    from mujoco import sysid as toolbox

    if not hasattr(toolbox, "build_residual_fn"):
        raise ImportError('mujoco.sysid lacks what it needs: pip install "mujoco[sysid]"')
    mine = [one for one in parameters if one.write is not None]
    given = toolbox.ParameterDict()
    for one in mine:
        start = float(np.clip(one.start, one.low, one.high))
        given.add(
            toolbox.Parameter(
                one.name,
                nominal=start,
                min_value=one.low,
                max_value=one.high,
                modifier=lambda spec, value, write=one.write: write(spec, float(value.value[0])),
            )
        )
    begun, best = time.perf_counter(), [np.inf, None]
    nq = compiled(mjcf, [], [])[0].nq

    def compare(params, predicted, measured, model, return_all, *, state, **_):
        del params, predicted, return_all
        if time.perf_counter() - begun > seconds:
            raise TimeoutError
        frames = state[frame_skip - 1 :: frame_skip, 1 : 1 + nq]
        residual = np.nan_to_num(frames - measured.data, nan=10.0, posinf=10.0, neginf=-10.0)
        return residual, toolbox.TimeSeries(measured.times, frames, measured.signal_mapping), measured

    built = toolbox.build_residual_fn(
        models_sequences=[_sequences(mjcf, stretches, frame_skip)],
        modify_residual=compare,
        resample_true=False,
    )

    def residual(x, *args, **more):
        found = built(x, *args, **more)
        values = np.asarray(x, dtype=float)
        # Its optimizers ask of several points at once, a column each.
        if values.ndim == 1 or values.shape[-1] == 1:
            misfit = float(sum(np.sum(np.square(one)) for one in found[0]))
            if misfit < best[0]:
                best[:] = [misfit, values.ravel().copy()]
        return found

    half_widths = None
    try:
        found, result = toolbox.optimize(
            initial_params=given, residual_fn=residual, optimizer="mujoco", verbose=False
        )
        last, _, _ = built(result.x, found)
        half_widths = np.ravel(toolbox.calculate_intervals(last, result.jac)[1]).tolist()
        best[1] = np.ravel(result.x)
    except TimeoutError:
        pass
    return mine, best[1], half_widths, time.perf_counter() - begun


def _sequences(mjcf, stretches, frame_skip):
    """Return stretches as ``mujoco.sysid`` takes them, with controls at every time step."""
    from mujoco import sysid as toolbox

    spec = mujoco.MjSpec.from_string(mjcf)
    model = spec.compile()
    h = model.opt.timestep
    mapping = {"angles": (toolbox.SignalType.CustomObs, np.arange(model.nq))}
    starts, controls, measured = [], [], []
    for one in stretches:
        actions = np.repeat(one.commands, frame_skip, axis=0)
        # Its rollout leaves the last control out.
        actions = np.concatenate([actions, actions[-1:]])
        starts.append(toolbox.create_initial_state(model, one.qpos, one.qvel))
        controls.append(toolbox.TimeSeries(h * np.arange(len(actions)), actions))
        times = h * frame_skip * np.arange(1, len(one.after) + 1)
        measured.append(toolbox.TimeSeries.create(times, one.after, mapping))
    names = [str(number) for number in range(len(stretches))]
    return toolbox.ModelSequences("log", spec, names, starts, controls, measured, allow_missing_sensors=True)


# -- what may be written into a spec -----------------------------------------------------------------------------------


def friction(joint):
    """Return how a dry friction is written, N m."""
    return _of_joint(joint, "frictionloss")


def damping(joint):
    """Return how a damping is written, N m s/rad."""

    def write(spec, value):
        spec.joint(joint).damping[0] = value

    return write


def armature(joint):
    """Return how a rotor's inertia is written, kg m2."""
    return _of_joint(joint, "armature")


def _of_joint(joint, attribute):
    def write(spec, value):
        setattr(spec.joint(joint), attribute, value)

    return write


def kp(actuator):
    """Return how a servo's stiffness is written, N m/rad; a shift of its target stays in rad."""

    def write(spec, value):
        servo = spec.actuator(actuator)
        shift = servo.biasprm[0] / servo.gainprm[0]
        servo.gainprm[0], servo.biasprm[1], servo.biasprm[0] = value, -value, value * shift

    return write


def offset(actuator):
    """Return how a shift of a servo's target is written, rad."""

    def write(spec, value):
        servo = spec.actuator(actuator)
        servo.biasprm[0] = servo.gainprm[0] * value

    return write


def gain(actuator):
    """Return how the torque of a motor for one unit of its command is written."""

    def write(spec, value):
        spec.actuator(actuator).gear[0] = value

    return write


def body_mass(mjcf, body):
    """Return how the factor of a body's mass and inertia in a model is written."""
    mine = mujoco.MjSpec.from_string(mjcf).body(body)
    mass, inertia = float(mine.mass), np.array(mine.inertia)

    def write(spec, value):
        spec.body(body).mass, spec.body(body).inertia = value * mass, value * inertia

    return write


def kv(actuator):
    """Return how a servo's own damping is written, N m s/rad."""

    def write(spec, value):
        spec.actuator(actuator).biasprm[2] = -value

    return write
