"""A diagnosis is the same whoever simulates: this process, others, or a cluster."""

import joblib
import numpy as np
import pytest

from skat.diagnosis import SimulationDiagnosis, statespace
from skat.simulators import MujocoSimulator

CART = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.1 0.1 0.1" mass="1"/>
      <body name="pole"><joint name="hinge" type="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.03" mass="0.3"/></body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="rail"/></actuator>
</mujoco>
"""

EFFECTS = ["mass[cart]", "armature[rail]"]


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(0)
    simulator = MujocoSimulator(CART, frame_skip=2)
    commands = rng.normal(scale=3, size=(12, 15, 1))
    states = simulator.rollout(rng.normal(size=(12, 4)), commands, n_steps=15, effects={"mass[cart]": 1.15})
    states += 0.01 * states.std(axis=(0, 1)) * rng.normal(size=states.shape)
    X = np.concatenate([states[:, :-1], commands], axis=2).reshape(-1, 5)
    return X, states[:, 1:].reshape(-1, 4), np.repeat(np.arange(12), 15)


def findings(log, **parameters):
    diagnosis = SimulationDiagnosis(
        MujocoSimulator(CART, frame_skip=2), effects=EFFECTS, random_state=0, **parameters
    )
    X, y, groups = log
    diagnosis.fit(X, y, groups=groups)
    return diagnosis.verdict_, diagnosis.causes_, diagnosis.gain_


@pytest.fixture(scope="module")
def alone(log):
    return findings(log)


@pytest.fixture
def shared_calls(monkeypatch):
    """Count the calls that go to other processes."""
    calls = []

    def counted(*arguments, **options):
        calls.append(options)
        return joblib.Parallel(*arguments, **options)

    monkeypatch.setattr(statespace, "Parallel", counted)
    return calls


def test_cause_is_found(alone):
    verdict, causes, _ = alone
    assert verdict in ("named", "ambiguous")
    # On a rail the mass of the cart and the armature of the rail are one thing.
    assert "mass[cart]" in (causes[0].name, *(alias.name for alias in causes[0].aliases))


def test_processes_do_not_change_the_answer(log, alone, shared_calls):
    assert findings(log, n_jobs=2) == alone
    assert shared_calls


def test_cluster_does_not_change_the_answer(log, alone, shared_calls):
    distributed = pytest.importorskip("distributed")
    # One process of two threads: most of the time of another goes into its imports.
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=":0") as cluster,
        distributed.Client(cluster),
        joblib.parallel_config(backend="dask"),
    ):
        assert findings(log) == alone
    assert shared_calls
