"""Simulators: rows of states and actions in, rows of next states out, with named effects."""

from skat.simulators.base import Simulator
from skat.simulators.function import FunctionSimulator

__all__ = ["FunctionSimulator", "Simulator"]
