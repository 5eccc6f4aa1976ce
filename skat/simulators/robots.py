"""The Gymnasium robots Hopper, HalfCheetah and Ant, under the conditions of the paper's Table I."""

from importlib.util import find_spec
from pathlib import Path

from skat.simulators.mujoco import MujocoSimulator

# Gymnasium's file and frame skip: gymnasium.envs.mujoco, versions v5.
ROBOTS = {"hopper": ("hopper.xml", 4), "halfcheetah": ("half_cheetah.xml", 5), "ant": ("ant.xml", 5)}
CONDITIONS = ("normal", "light", "heavy", "long", "short", "some_inverted", "inverted", "some_off")


def make_robot(name: str, condition: str) -> MujocoSimulator:
    """Return a Gymnasium robot under a condition of Table I.

    Parameters
    ----------
    name : {"hopper", "halfcheetah", "ant"}
    condition : str
        "normal"; "light" (every mass times 0.5), "heavy" (2.0); "long" (every link's length times 1.5),
        "short" (0.5); "some_inverted" (actuators 2, 4, 6, ..., counted from 1), "inverted" (all); "some_off"
        (2, 4, 6, ...).

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Table I.
    """
    file, frame_skip = ROBOTS[name]
    robot = MujocoSimulator(asset_folder() / file, frame_skip=frame_skip)
    values = _condition_effects(robot, condition)
    return robot.extended(values) if values else robot


def asset_folder() -> Path:
    """Return the folder of Gymnasium's MuJoCo models, without importing Gymnasium."""
    spec = find_spec("gymnasium")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(
            "the robots' models come with gymnasium: python -m pip install 'gymnasium[mujoco]'",
            name="gymnasium",
        )
    return Path(spec.origin).parent / "envs" / "mujoco" / "assets"


def _condition_effects(robot: MujocoSimulator, condition: str) -> dict[str, float]:
    gains = [effect.name for effect in robot.effects() if effect.family == "gain" and effect.target != "all"]
    return {
        "normal": {},
        "light": {"mass[all]": 0.5},
        "heavy": {"mass[all]": 2.0},
        "long": {"length[all]": 1.5},
        "short": {"length[all]": 0.5},
        "some_inverted": dict.fromkeys(gains[1::2], -1.0),
        "inverted": {"gain[all]": -1.0},
        "some_off": dict.fromkeys(gains[1::2], 0.0),
    }[condition]
