"""Skat beside the tools that people use for the same tasks, on the same rows: every number of docs/comparison.rst.

*Carrying.* Rows are (state, action, next state) of one robot in two worlds of the paper's Table I, replayed from the
same states and actions, so that each carried row has a true partner. Every method is fitted on the same rows and tested
on others. The error is the mean distance of a carried row and its partner, each column of the next state in standard
deviations of the target. Printed is its ratio to the error of doing nothing, medians over the worlds, and CPU seconds
of one fit and transform. The peers are given columns scaled by both domains together: as they come, they fail or do
worse; linear maps get a ridge of 1e-6, as their default of 1e-8 fails in most of these worlds. "pairs" says that a
method is told which rows belong together. Regression carries no distribution, and the first has no simulation.

*Finding.* The log of README's arm, whose elbow rubs (0.6 N m) and whose model has a coarser time step: six episodes to
fit, two to test. The error is that of open loop over one second from the measured state, root mean squared, rad. Two
people use ``mujoco.sysid``: one asks for the frictions among others, one does not think of friction. PySINDy has
polynomials, sines and the sign of each speed to choose from, once without the simulation and once for what the
simulation misses; its threshold is the one that does best on the last episode to fit. Below each stands what it says.

    pip install -e ".[bench]"
    python benchmarks/peers.py                   # several minutes
    python benchmarks/peers.py --small           # a minute
    python benchmarks/peers.py --only finding

ADAPT needs TensorFlow and an older scikit-learn, hence an environment of its own; without it, its row is left out::

    python3.11 -m venv adapt-env
    adapt-env/bin/pip install adapt tensorflow-cpu tf-keras "scikit-learn<1.6"
    python benchmarks/peers.py --adapt-python adapt-env/bin/python
"""

import argparse
import contextlib
import io
import logging
import runpy
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from sklearn import config_context
from sklearn.linear_model import RidgeCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

import skat
from skat.experiments import replay_transitions

WORLDS = ("light", "heavy", "long", "short", "some_inverted", "inverted", "some_off")


def by_skat(estimator):
    """Return a method that fits an estimator of skat."""
    return lambda X, y, new, _: estimator.fit(X, y).transform(new)


def by_pot(name, **options):
    """Return a method that fits one of POT's transports."""

    def carry(X, y, new, _):
        import ot

        return getattr(ot.da, name)(**options).fit(Xs=X, Xt=y).transform(Xs=new)

    return scaled(carry)


def scaled(method):
    """Return a method in columns scaled by those of both domains together, as skada's examples have it."""

    def carry(X, y, new, context):
        scaler = StandardScaler().fit(np.vstack([X, y]))
        carried = method(scaler.transform(X), scaler.transform(y), scaler.transform(new), context)
        return scaler.inverse_transform(carried)

    return carry


def by_skada(name, **options):
    """Return a method that fits one of skada's adapters on stacked rows."""

    def carry(X, y, new, _):
        import skada

        model = getattr(skada, name)(**options)
        domain = np.repeat([1, -2], [len(X), len(y)])
        model.fit(np.vstack([X, y]), sample_domain=domain)
        return model.transform(new, sample_domain=np.ones(len(new), int), allow_source=True)

    return scaled(carry)


def by_ott(entropic):
    """Return a method that carries by ott-jax: its affine map, or its entropic one."""

    def carry(X, y, new, _):
        import jax

        jax.config.update("jax_enable_x64", True)
        from ott.geometry.pointcloud import PointCloud
        from ott.solvers import linear
        from ott.tools.gaussian_mixture.gaussian import Gaussian

        if entropic:
            return linear.solve(PointCloud(X, y)).to_dual_potentials().transport(new)
        # From moments with the same ridge as the others: its own estimate of a covariance is singular here.
        laws = [
            Gaussian.from_mean_and_cov(Z.mean(axis=0), np.cov(Z.T) + 1e-6 * np.eye(Z.shape[1]))
            for Z in (X, y)
        ]
        return laws[0].transport(laws[1], new)

    return scaled(carry)


ADAPT = """
import sys, time
import numpy as np
from adapt.feature_based import CORAL
given = np.load(sys.argv[1])
began = time.process_time()
model = CORAL(lambda_=1e-6, verbose=0)
model.fit_transform(given["X"], given["y"])
carried = model.transform(given["new"], domain="src")
np.savez(sys.argv[2], carried=carried, seconds=time.process_time() - began)
"""


def by_adapt(python):
    """Return a method that carries by ADAPT's CORAL in the environment of another interpreter."""

    def carry(X, y, new, _):
        if not python:
            raise ImportError("left out: no --adapt-python")
        with tempfile.TemporaryDirectory() as folder:
            given, back = Path(folder, "given.npz"), Path(folder, "back.npz")
            np.savez(given, X=X, y=y, new=new)
            subprocess.run([python, "-c", ADAPT, given, back], check=True, capture_output=True)
            with np.load(back) as found:
                carry.seconds = float(found["seconds"])
                return found["carried"]

    method = scaled(carry)
    method.inner = carry
    return method


def by_regression(of_what):
    """Return a ridge regression of what the target has: on the inputs alone, or on the simulated row as well."""

    def carry(X, y, new, context):
        inputs, given = (X[:, :context], new[:, :context]) if of_what == "inputs" else (X, new)
        model = make_pipeline(StandardScaler(), RidgeCV(np.logspace(-6, 3, 10), alpha_per_target=True))
        return np.hstack([new[:, :context], model.fit(inputs, y[:, context:]).predict(given)])

    return carry


def methods(context, adapt_python=None):
    """Return the methods by name, and whether they are told the pairs."""
    return {
        "skat AffineTransport": (by_skat(skat.AffineTransport()), False),
        'skat AffineTransport("target")': (by_skat(skat.AffineTransport(metric_scale="target")), False),
        "skat CORAL": (by_skat(skat.CORAL()), False),
        "skat ConditionalAffineTransport": (by_skat(skat.ConditionalAffineTransport(context=context)), False),
        "skat ProcrustesAffineTransport": (by_skat(skat.ProcrustesAffineTransport()), True),
        "POT LinearTransport": (by_pot("LinearTransport", reg=1e-6), False),
        "POT EMDTransport": (by_pot("EMDTransport"), False),
        "POT SinkhornTransport": (by_pot("SinkhornTransport", reg_e=0.1, norm="median", max_iter=300), False),
        "skada LinearOTMappingAdapter": (by_skada("LinearOTMappingAdapter", reg=1e-6), False),
        "skada CORALAdapter": (by_skada("CORALAdapter"), False),
        "ADAPT CORAL": (by_adapt(adapt_python), False),
        "ott-jax Gaussian.transport": (by_ott(entropic=False), False),
        "ott-jax entropic map": (by_ott(entropic=True), False),
        "sklearn ridge, without simulation": (by_regression("inputs"), True),
        "sklearn ridge of the simulated row": (by_regression("rows"), True),
    }


def compared(robot, n_rows, worlds, adapt_python):
    """Return ratios and seconds by method, one of each per world, and what failed."""
    replay = replay_transitions(robot, n_transitions=2 * n_rows, conditions=("normal", *worlds))
    order = np.random.default_rng(0).permutation(2 * n_rows)
    fit, test = order[:n_rows], order[n_rows:]
    source, context = replay.rows("normal"), replay.context
    ratios, seconds, failed = {}, {}, {}
    for world in worlds:
        target = replay.rows(world)
        scale = target[fit, context:].std(axis=0)

        def error(rows, target=target, scale=scale):
            apart = (rows - target[test])[:, context:] / np.where(scale > 0, scale, 1)
            return np.linalg.norm(apart, axis=1).mean()

        before = error(source[test])
        for name, (carry, _) in methods(context, adapt_python).items():
            began = time.process_time()
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # of peers; an error below shows what matters
                    carried = np.asarray(carry(source[fit], target[fit], source[test], context))
            except (ImportError, ValueError, np.linalg.LinAlgError) as problem:
                failed.setdefault(name, []).append(
                    f"{type(problem).__name__}: {str(problem).splitlines()[0][:60]}"
                )
                continue
            elsewhere = getattr(getattr(carry, "inner", None), "seconds", None)
            seconds.setdefault(name, []).append(elsewhere or time.process_time() - began)
            ratios.setdefault(name, []).append(error(carried) / before)
    return ratios, seconds, failed


@dataclass(frozen=True)
class ArmLog:
    """Episodes of README's arm: states (n_episodes, n_rows, 4), commands (n_episodes, n_rows, 2), its simulator."""

    states: np.ndarray
    commands: np.ndarray
    simulator: object
    mjcf: str
    step: float

    def rows(self, episodes):
        """Return X, y and groups of some episodes."""
        states, commands = self.states[episodes], self.commands[episodes]
        X = np.concatenate([states[:, :-1], commands[:, :-1]], axis=2)
        groups = np.repeat(np.arange(len(states)), X.shape[1])
        return X.reshape(-1, X.shape[-1]), states[:, 1:].reshape(-1, states.shape[-1]), groups

    def stretches(self, episodes, n_steps):
        """Return first states, commands and the states to come, of stretches of so many steps."""
        places = [(e, k) for e in episodes for k in range(0, self.states.shape[1] - n_steps, n_steps)]
        first = np.array([self.states[e, k] for e, k in places])
        commands = np.array([self.commands[e, k : k + n_steps] for e, k in places])
        return first, commands, np.array([self.states[e, k + 1 : k + n_steps + 1] for e, k in places])


def arm_log():
    """Return the log that README's picture is of."""
    from skat.simulators import MujocoSimulator

    readme = runpy.run_path(str(Path(__file__).parent.parent / "docs" / "readme.py"))
    table = readme["measured"]()
    names = list(table.columns[2:])
    episodes = [rows[names].to_numpy() for _, rows in table.groupby("episode")]
    values = np.stack(episodes)
    simulator = MujocoSimulator(readme["ARM"], frame_skip=round(readme["STEP"] / 0.002))
    return ArmLog(values[..., :4], values[..., 4:], simulator, readme["ARM"], readme["STEP"])


def found_by_skat(log, fit, small):
    """Return how the extended model rolls, and what is said, by a diagnosis that is told nothing."""
    from skat.diagnosis import SimulationDiagnosis

    X, y, groups = log.rows(fit)
    effects = ["dry_friction[elbow]", "damping[elbow]", "timestep"] if small else "all"
    diagnosis = SimulationDiagnosis(log.simulator, effects=effects, random_state=0).fit(X, y, groups=groups)
    said = [f"{c.name} {c.value:.3g} [{c.interval[0]:.3g}, {c.interval[1]:.3g}]" for c in diagnosis.causes_]
    return rolled_by(diagnosis.extended_simulator_), [diagnosis.verdict_, *said]


def rolled_by(simulator):
    """Return a function from first states and commands to the states of a simulator in open loop."""
    return lambda first, commands: simulator.rollout(first, commands, n_steps=commands.shape[1])[:, 1:]


# What `mujoco.sysid` may be asked for: neutral, smallest, largest, and the edit.
def _friction(joint):
    return lambda spec, p: setattr(spec.joint(joint), "frictionloss", p.value[0])


def _armature(joint):
    return lambda spec, p: setattr(spec.joint(joint), "armature", 0.01 + p.value[0])


def _damping(joint):
    def edit(spec, p):
        spec.joint(joint).damping[0] = 0.4 + p.value[0]

    return edit


def _mass(spec, p):
    spec.body("lower").geoms[0].mass = 0.8 * p.value[0]


PARAMETERS = {
    "mass[lower]": (1.0, 0.3, 3.0, _mass),
    **{f"damping[{j}]": (0.0, -0.39, 5.0, _damping(j)) for j in ("shoulder", "elbow")},
    **{f"armature[{j}]": (0.0, 0.0, 1.0, _armature(j)) for j in ("shoulder", "elbow")},
    **{f"dry_friction[{j}]": (0.0, 0.0, 5.0, _friction(j)) for j in ("shoulder", "elbow")},
}


def found_by_sysid(log, fit, names):
    """Return how the fitted model rolls, and what is said, by ``mujoco.sysid`` with these parameters."""
    import mujoco
    from mujoco import sysid

    from skat.simulators import MujocoSimulator

    logging.disable(logging.WARNING)
    parameters = sysid.ParameterDict()
    for name in names:
        neutral, low, high, edit = PARAMETERS[name]
        parameters.add(sysid.Parameter(name, nominal=neutral, min_value=low, max_value=high, modifier=edit))
    skip, n_steps = log.simulator.frame_skip, 10
    first, commands, measured = log.stretches(fit, n_steps)
    spread, model = measured.reshape(-1, 4).std(axis=0), mujoco.MjModel.from_xml_string(log.mjcf)
    mapping = {"state": (sysid.SignalType.CustomObs, np.arange(4))}
    h = model.opt.timestep
    starts, controls, series = [], [], []
    for state, command, after in zip(first, commands, measured, strict=True):
        every = np.repeat(command, skip, axis=0)
        every = np.concatenate([every, every[-1:]])  # Its rollout leaves the last control out.
        starts.append(sysid.create_initial_state(model, state[:2], state[2:]))
        controls.append(sysid.TimeSeries(h * np.arange(len(every)), every))
        series.append(sysid.TimeSeries.create(h * skip * np.arange(1, n_steps + 1), after, mapping))
    sequences = sysid.ModelSequences(
        "arm",
        mujoco.MjSpec.from_string(log.mjcf),
        [str(k) for k in range(len(starts))],
        starts,
        controls,
        series,
        allow_missing_sensors=True,
    )

    def compare(params, predicted, measured, model, return_all, *, state, **_):
        frames = state[skip - 1 :: skip, 1:5]
        residual = (frames - measured.data) / spread
        return residual, sysid.TimeSeries(measured.times, frames, measured.signal_mapping), measured

    residual = sysid.build_residual_fn(
        models_sequences=[sequences], modify_residual=compare, resample_true=False
    )
    with contextlib.redirect_stdout(io.StringIO()):
        found, result = sysid.optimize(
            initial_params=parameters, residual_fn=residual, optimizer="mujoco", verbose=False
        )
    residuals, _, _ = residual(result.x, found)
    _, half = sysid.calculate_intervals(residuals, result.jac)
    spec = mujoco.MjSpec.from_string(log.mjcf)
    for name in names:
        PARAMETERS[name][3](spec, found[name])
    said = [
        f"{name} {x:.3g} [{x - w:.3g}, {x + w:.3g}]" for name, x, w in zip(names, result.x, half, strict=True)
    ]
    return rolled_by(MujocoSimulator(spec.to_xml(), frame_skip=skip)), said


def found_by_pysindy(log, fit, simulator=None):
    """Return how equations roll, and what is said, of all of the motion or of what the simulation misses."""
    import pysindy

    def library():
        sign = pysindy.CustomLibrary(
            [lambda x: np.tanh(x / 0.05), lambda x: np.sin(x), lambda x: np.cos(x)],
            [lambda x: f"sign({x})", lambda x: f"sin({x})", lambda x: f"cos({x})"],
        )
        return pysindy.ConcatLibrary([pysindy.PolynomialLibrary(degree=2), sign])

    def missed(X, y):
        before = X[:, :4] if simulator is None else simulator.predict(X)
        return (y - before) / log.step

    def fitted(episodes, threshold):
        parts = [log.rows([episode]) for episode in episodes]
        optimizer = pysindy.STLSQ(threshold=threshold, alpha=1e-3, normalize_columns=True)
        model = pysindy.DiscreteSINDy(optimizer=optimizer, feature_library=library())
        model.fit(
            [X[:, :4] for X, _, _ in parts],
            t=log.step,
            x_next=[missed(X, y) for X, y, _ in parts],
            u=[X[:, 4:] for X, _, _ in parts],
            feature_names=["q1", "q2", "v1", "v2", "u1", "u2"],
        )
        return model

    def rolled(model):
        def roll(first, commands):
            state, path = first, []
            for command in commands.transpose(1, 0, 2):
                rate = np.asarray(model.predict(state, u=command))
                X = np.hstack([state, command])
                state = (state if simulator is None else simulator.predict(X)) + log.step * rate
                state = np.clip(np.nan_to_num(state), -1e3, 1e3)
                path.append(state)
            return np.stack(path, axis=1)

        return roll

    # Columns are normalised to unit length, so that thresholds grow with the root of the number of rows.
    thresholds = np.sqrt(len(fit) * log.states.shape[1]) * np.array([0.003, 0.01, 0.03, 0.1, 0.3, 1.0])
    best = min(thresholds, key=lambda each: open_loop_error(log, fit[-1:], rolled(fitted(fit[:-1], each))))
    model = fitted(fit, best)
    coefficients, names = model.coefficients(), model.get_feature_names()
    sign = coefficients[3, names.index("sign(v2)")]
    said = f"{np.count_nonzero(coefficients)} terms; sign of the elbow's speed: {sign:.3g} rad/s^2 in its equation"
    return rolled(model), [said]


def open_loop_error(log, episodes, roll):
    """Return the root mean squared error of the angles over one second from measured states, rad."""
    first, commands, measured = log.stretches(episodes, round(1 / log.step))
    return float(np.sqrt(np.mean((roll(first, commands) - measured)[..., :2] ** 2)))


def finding(small):
    """Print who finds the elbow's friction, and whose model predicts."""
    log = arm_log()
    fit, test = list(range(6)), [6, 7]
    right = ["mass[lower]", "damping[elbow]", "dry_friction[shoulder]", "dry_friction[elbow]"]
    wrong = ["mass[lower]", "damping[shoulder]", "damping[elbow]", "armature[elbow]"]
    tools = {
        "the model as it is": lambda: (rolled_by(log.simulator), []),
        "skat, nothing given": lambda: found_by_skat(log, fit, small),
        "mujoco.sysid, frictions given": lambda: found_by_sysid(log, fit, right),
        "mujoco.sysid, frictions not given": lambda: found_by_sysid(log, fit, wrong),
        "PySINDy, without the simulation": lambda: found_by_pysindy(log, fit),
        "PySINDy of what the simulation misses": lambda: found_by_pysindy(log, fit, log.simulator),
    }
    print("\nREADME's arm, dry friction of 0.6 N m in the elbow: 894 transitions to fit, 298 others to test")
    print(f"{'tool':40}{'error over 1 s, rad':>20}{'CPU s':>8}")
    for name, run in tools.items():
        began = time.process_time()
        try:
            # skada turns routing on for the whole process, which PySINDy's pipelines do not take part in.
            with warnings.catch_warnings(), config_context(enable_metadata_routing=False):
                warnings.simplefilter("ignore")
                roll, said = run()
                error = open_loop_error(log, test, roll)
        except ImportError as problem:
            print(f"{name:40}  left out: {problem}")
            continue
        print(f"{name:40}{error:20.4f}{time.process_time() - began:8.1f}")
        print(*(f"    {line}" for line in said), sep="\n", end="\n" * bool(said), flush=True)


def carrying(small, adapt_python):
    """Print whose carried rows are nearest to their partners."""
    for robot in ("hopper",) if small else ("hopper", "halfcheetah"):
        n_rows, worlds = (200, WORLDS[:2]) if small else (500, WORLDS)
        ratios, seconds, failed = compared(robot, n_rows, worlds, adapt_python)
        print(f"\n{robot}: {n_rows} rows to fit, {n_rows} others to test, {len(worlds)} worlds")
        print(f"{'method':36}{'pairs':>6}{'error after / before':>22}{'worst world':>13}{'CPU s':>8}")
        for name, (_, paired) in methods(1).items():
            told = "yes" if paired else "no"
            if name in ratios:
                print(
                    f"{name:36}{told:>6}{np.median(ratios[name]):22.3f}{np.max(ratios[name]):13.3f}"
                    f"{np.median(seconds[name]):8.2f}"
                )
            if name in failed:
                print(f"{name:36}{told:>6}  fails in {len(failed[name])} worlds: {failed[name][0]}")


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--small", action="store_true", help="one robot, two worlds, few rows, three effects")
    parser.add_argument("--only", choices=["carrying", "finding"], help="one of the two")
    parser.add_argument("--adapt-python", help="interpreter of an environment with ADAPT")
    arguments = parser.parse_args()
    print(versions(), flush=True)
    if arguments.only != "finding":
        carrying(arguments.small, arguments.adapt_python)
    if arguments.only != "carrying":
        finding(arguments.small)


def versions():
    """Return who took part."""
    from importlib.metadata import PackageNotFoundError, version

    found = [f"Python {sys.version.split()[0]}"]
    for package in ("numpy", "scikit-learn", "POT", "skada", "ott-jax", "mujoco", "pysindy"):
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            found.append(f"{package} is not installed")
    return ", ".join(found)


if __name__ == "__main__":
    main()
