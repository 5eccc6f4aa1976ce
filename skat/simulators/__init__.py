"""Simulators: rows of states and actions in, rows of next states out, with named effects."""

from skat.simulators.base import Simulator
from skat.simulators.function import FunctionSimulator
from skat.simulators.making import make_simulator
from skat.simulators.mujoco import MujocoSimulator

__all__ = ["FunctionSimulator", "MujocoSimulator", "Simulator", "make_simulator"]
