"""
A simulator of one's own, in Python
===================================

Not every simulation is a MuJoCo model. This one is a function: a cart on two driven wheels, by the equations that stand
in every textbook. What may be wrong with it is declared as effects; the real cart, which here is another program,
has a left tyre that is worn by 3 %.
"""

# sphinx_gallery_thumbnail_number = 2
# %%
# A simulation is a function of rows, (x, y, heading, speed, rate, left, right) to the next state, and of the effects
# by name. Half a dozen steps of Heun's method go into a transition of 0.1 s.

import numpy as np
from scipy.integrate import solve_ivp

from skat.diagnosis import SimulationDiagnosis
from skat.effects import Effect
from skat.plotting import CauseDisplay, TrajectoryDisplay
from skat.simulators import FunctionSimulator

DT, SUBSTEPS = 0.1, 6
RADIUS, TRACK, LAG = 0.05, 0.3, 0.25  # m, m, s
STATE = ("x", "y", "heading", "speed", "rate")


def drive(X, **effects):
    """Return the states 0.1 s after the states and wheel speeds in the rows of X."""
    state, left, right = X[:, :5], X[:, 5], X[:, 6]
    left = RADIUS * effects["radius[left_wheel]"] * left
    right = RADIUS * effects["radius[right_wheel]"] * right
    lag = LAG * effects["lag"]

    def slope(state):
        _, _, heading, speed, rate = state.T
        downhill = 9.81 * np.sin(effects["tilt[x]"]) * np.cos(heading)
        return np.column_stack(
            [
                speed * np.cos(heading),
                speed * np.sin(heading),
                rate,
                ((left + right) / 2 - speed) / lag + downhill - effects["drag"] * speed * np.abs(speed),
                ((right - left) / (TRACK * effects["track"]) - rate) / lag,
            ]
        )

    step = DT / SUBSTEPS
    for _ in range(SUBSTEPS):
        here = slope(state)
        state = state + step / 2 * (here + slope(state + step * here))
    return state


# %%
# Each effect has a unit, the value at which the simulation is as written, and the range that makes sense. Errors of
# the sensors, ``bias[...]`` and ``scale[...]``, are added by themselves. Units of the columns are for the reader, and
# tell angles from other numbers.

simulator = FunctionSimulator(
    drive,
    input_names=(*STATE, "left", "right"),
    output_names=STATE,
    state_names=STATE,
    units={"x": "m", "y": "m", "heading": "rad", "speed": "m/s", "rate": "rad/s"},
    dt=DT,
    effects=[
        Effect("radius[left_wheel]", unit="1", neutral=1.0, bounds=(0.5, 2.0)),
        Effect("radius[right_wheel]", unit="1", neutral=1.0, bounds=(0.5, 2.0)),
        Effect("track", unit="1", neutral=1.0, bounds=(0.5, 2.0)),
        Effect("lag", unit="1", neutral=1.0, bounds=(0.2, 5.0)),
        Effect("tilt[x]", unit="rad", neutral=0.0, bounds=(-0.3, 0.3)),
        Effect("drag", unit="1/m", neutral=0.0, bounds=(0.0, 5.0)),
    ],
)

# %%
# The measurements come from another program, with a step of its own and noise in every channel.


def measure(n_episodes, n_steps, seed, wear=0.97):
    """Return X, y and the episode of each row."""
    rng = np.random.default_rng(seed)

    def motion(_, state, left, right):
        speeds = RADIUS * np.array([wear * left, right])
        target, turning = speeds.mean(), (speeds[1] - speeds[0]) / TRACK
        heading, speed, rate = state[2:]
        forward = speed * np.cos(heading), speed * np.sin(heading)
        return (*forward, rate, (target - speed) / LAG, (turning - rate) / LAG)

    states, wheels = np.zeros((n_episodes, n_steps + 1, 5)), np.empty((n_episodes, n_steps, 2))
    for episode in range(n_episodes):
        states[episode, 0, 2] = rng.uniform(-np.pi, np.pi)
        for step in range(n_steps):
            changes = step % 10 == 0
            wheels[episode, step] = rng.uniform(-10, 20, 2) if changes else wheels[episode, step - 1]
            path = solve_ivp(
                motion, (0, DT), states[episode, step], args=tuple(wheels[episode, step]), rtol=1e-8
            )
            states[episode, step + 1] = path.y[:, -1]
    states += rng.normal(size=states.shape) * [0.005, 0.005, 0.01, 0.01, 0.02]
    X = np.concatenate([states[:, :-1], wheels], axis=2).reshape(-1, 7)
    return X, states[:, 1:].reshape(-1, 5), np.repeat(np.arange(n_episodes), n_steps)


X, y, episodes = measure(n_episodes=12, n_steps=50, seed=0)

# %%
# A worn tyre makes the cart turn; so would a track of another width, a gyroscope with a bias, or a slope. What is
# named is what explains all channels in all rows.

diagnosis = SimulationDiagnosis(simulator, random_state=0).fit(X, y, groups=episodes)
print(diagnosis.verdict_, *(cause.sentence for cause in diagnosis.causes_), sep="\n")
causes = CauseDisplay.from_estimator(diagnosis)

# %%
# In open loop, on a drive that was not used: the simulation as written turns off the road.

X_new, y_new, _ = measure(n_episodes=1, n_steps=100, seed=1)
paths = TrajectoryDisplay.from_estimator(diagnosis, X_new, y_new)

# %%
# ``diagnosis.extended_simulator_`` is the function with the effect built in:

diagnosis.extended_simulator_.predict(X_new[:1]).round(3)
