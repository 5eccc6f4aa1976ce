"""Small machines: MJCF with a wheel, tendons or servos, plain MuJoCo to step any, and a heater that is a function."""

import re

import mujoco
import numpy as np

from skat.effects import Effect
from skat.simulators import FunctionSimulator

ROLLER = """
<mujoco model="roller">
  <option timestep="0.002" cone="elliptic"/>
  <worldbody>
    <geom type="plane" size="50 5 .1"/>
    <body name="frame" pos="0 0 .1">
      <joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
      <geom type="box" size=".1 .05 .02" mass="1" contype="0" conaffinity="0"/>
      <body name="wheel"><joint name="axle" axis="0 1 0" damping=".01" armature=".002"/>
        <geom name="tyre" type="cylinder" size=".1 .02" euler="90 0 0" mass=".4"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="drive" joint="axle" gear=".5" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
FINGER = """
<mujoco model="finger">
  <option timestep="0.002"/>
  <worldbody>
    <site name="anchor" pos="-.05 0 .1"/>
    <body name="near"><joint name="knuckle" axis="0 1 0" damping=".02"/>
      <geom type="capsule" size=".01" fromto="0 0 0 .06 0 0" mass=".1" contype="0"/>
      <body name="far" pos=".06 0 0"><joint name="tip" axis="0 1 0" damping=".01" armature=".0002"/>
        <geom type="capsule" size=".01" fromto="0 0 0 .04 0 0" mass=".05" contype="0"/>
        <site name="nail" pos=".03 0 .01"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="flexor" damping="2"><joint joint="knuckle" coef=".02"/><joint joint="tip" coef=".01"/></fixed>
    <spatial name="band" stiffness="30" springlength=".12"><site site="anchor"/><site site="nail"/></spatial>
    <fixed name="single"><joint joint="tip" coef=".01"/></fixed>
  </tendon>
  <actuator>
    <motor name="pull" tendon="flexor" gear="8" ctrlrange="-1 1"/>
    <position name="servo" joint="tip" kp=".05" kv=".002" ctrlrange="-1 1" forcerange="-.2 .2"/>
  </actuator>
</mujoco>
"""
SERVO_ARM = """
<mujoco model="servo_arm">
  <option timestep="0.004" integrator="implicitfast"/>
  <default><joint damping=".3" armature=".02"/><geom contype="0"/></default>
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".025" mass="1.1"/>
      <body name="lower" pos=".3 0 0"><joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 .25 0 0" size=".02" mass=".7"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="lift" joint="shoulder" kp="120" kv="8" ctrlrange="-2 2" forcerange="-40 40"/>
    <position name="bend" joint="elbow" kp="80" kv="4" ctrlrange="-2 2" forcerange="-30 30"/>
  </actuator>
</mujoco>
"""


def changed(text, *changes):
    """Return a text with (old, new) pieces exchanged, each of which it must hold."""
    for old, new in changes:
        assert text.count(old) >= 1, old
        text = text.replace(old, new)
    return text


def without_limits(text):
    """Return a text without the limits of its actuators' forces."""
    return re.sub(r' forcerange="[^"]*"', "", text)


def plain(text, rows, n_steps, force=None, joint_forces=0.0, inertia=None):
    """Step each row in plain MuJoCo, each from a new MjData; `inertia` multiplies that of bodies, by name."""
    model = mujoco.MjModel.from_xml_string(text)
    for body, factor in (inertia or {}).items():
        model.body(body).inertia *= factor
        mujoco.mj_setConst(model, mujoco.MjData(model))
    found = []
    for row in rows:
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = np.split(row, [model.nq, model.nq + model.nv])
        for _ in range(n_steps):
            if force is not None:
                data.xfrc_applied[1, :3] = force
            data.qfrc_applied[:] = joint_forces
            mujoco.mj_step(model, data)
        found.append(np.r_[data.qpos, data.qvel])
    return np.array(found)


# A heater: what it loses in 1/s, and the time of a row in s.
RATE, DT = 3.0, 0.05


def decaying(X, rate=RATE, push=1.0):
    """A heater: what it has lost and what it was given, in a row's time."""
    left = np.exp(-rate * DT)
    return X[:, :1] * left + push * X[:, 1:] * (1 - left)


def heater(function=decaying):
    effects = [
        Effect("rate", unit="1/s", neutral=RATE, bounds=(0.1, 30.0), typical=1.0),
        Effect("push", unit="1", neutral=1.0, bounds=(0.1, 10.0)),
    ]
    names = {"input_names": ("warmth", "given"), "output_names": ("warmth",), "state_names": ("warmth",)}
    return FunctionSimulator(function, **names, effects=effects)
