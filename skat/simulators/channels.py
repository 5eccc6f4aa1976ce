"""Names of the columns of a MuJoCo state, and differences and displacements in its tangent space."""

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass

import mujoco
import numpy as np

from skat.simulators.tables import Array

UNIT_LENGTH_TOLERANCE = 0.2
FREE, BALL, SLIDE, HINGE = (
    int(kind)
    for kind in (
        mujoco.mjtJoint.mjJNT_FREE,
        mujoco.mjtJoint.mjJNT_BALL,
        mujoco.mjtJoint.mjJNT_SLIDE,
        mujoco.mjtJoint.mjJNT_HINGE,
    )
)


@dataclass(frozen=True)
class StateLayout:
    """The columns [qpos, qvel] of a model's state.

    Attributes
    ----------
    names, tangent_names : tuple of str
        Columns of the state, and of its tangent space, where a rotation vector (rad, in the body's frame)
        stands for a quaternion.
    units : tuple of str
        Unit of each column of the state.
    quaternions : tuple of (int, int)
        First column of each quaternion in the state, and of its rotation vector in the tangent space.
    plain : ndarray of (n, 2) int
        Columns of the other coordinates: in the state, and in the tangent space.
    """

    names: tuple[str, ...]
    tangent_names: tuple[str, ...]
    units: tuple[str, ...]
    quaternions: tuple[tuple[int, int], ...]
    plain: np.ndarray

    def normalised(self, states: Array, what: str) -> Array:
        """Return states with unit quaternions.

        Parameters
        ----------
        states : ndarray of shape (..., at least n_states)
        what : str
            The table's name, for the message.

        Raises
        ------
        ValueError
            If a quaternion's length is more than 20 % from 1.
        """
        if not self.quaternions:
            return states
        states = np.array(states)
        for column, _ in self.quaternions:
            length = np.linalg.norm(states[..., column : column + 4], axis=-1, keepdims=True)
            bad = np.abs(length[..., 0] - 1) > UNIT_LENGTH_TOLERANCE
            if bad.any():
                row = f" in row {np.argwhere(bad)[0][-1]}" if bad.ndim else ""
                raise ValueError(
                    f"{what} holds quaternions that are far from unit length: {self.names[column]} and the three "
                    f"columns after it have the length {length[..., 0][bad][0]:.3g}{row}; expected w, x, y, z with "
                    "length 1"
                )
            states[..., column : column + 4] /= length
        return states

    def aligned(self, states: Array, reference: Array) -> Array:
        """Give quaternions the sign that is closer to the reference's, in place, and return the states."""
        for column, _ in self.quaternions:
            block = slice(column, column + 4)
            opposite = np.sum(states[..., block] * reference[..., block], axis=-1) < 0
            states[..., block] = np.where(opposite[..., None], -states[..., block], states[..., block])
        return states

    def difference(self, states: Array, reference: Array) -> Array:
        """Return the tangent vectors that lead from the reference to the states."""
        if not self.quaternions:
            return states - reference
        states, reference = np.broadcast_arrays(states, reference)
        tangent = np.empty((*states.shape[:-1], len(self.tangent_names)))
        source, target = self.plain.T
        tangent[..., target] = states[..., source] - reference[..., source]
        for column, slot in self.quaternions:
            turn = quaternion_product(
                conjugate(reference[..., column : column + 4]), states[..., column : column + 4]
            )
            tangent[..., slot : slot + 3] = rotation_vector(turn)
        return tangent

    def displaced(self, states: Array, tangent: Array) -> Array:
        """Return the states moved by tangent vectors, the inverse of `difference`."""
        if not self.quaternions:
            return states + tangent
        shape = np.broadcast_shapes(states.shape[:-1], tangent.shape[:-1])
        moved = np.array(np.broadcast_to(states, (*shape, states.shape[-1])))
        source, target = self.plain.T
        moved[..., source] += tangent[..., target]
        for column, slot in self.quaternions:
            turn = quaternion(tangent[..., slot : slot + 3])
            moved[..., column : column + 4] = quaternion_product(moved[..., column : column + 4], turn)
        return moved


def state_layout(model: mujoco.MjModel) -> StateLayout:
    """Return the columns of a model's state, named after its joints."""
    position: list[tuple[str, str]] = []
    velocity: list[tuple[str, str]] = []
    moved: list[str] = []
    quaternions: list[tuple[int, int]] = []
    plain: list[tuple[int, int]] = []
    for joint in range(model.njnt):
        name, kind = joint_name(model, joint), int(model.jnt_type[joint])
        if kind == FREE:
            plain += [(len(position) + axis, len(moved) + axis) for axis in range(3)]
            position += [(f"qpos.{name}.{axis}", "m") for axis in "xyz"]
            velocity += [(f"qvel.{name}.v{axis}", "m/s") for axis in "xyz"]
            moved += [f"qpos.{name}.{axis}" for axis in "xyz"]
        if kind in (FREE, BALL):
            quaternions.append((len(position), len(moved)))
            position += [(f"qpos.{name}.q{part}", "1") for part in "wxyz"]
            velocity += [(f"qvel.{name}.w{axis}", "rad/s") for axis in "xyz"]
            moved += [f"qpos.{name}.r{axis}" for axis in "xyz"]
        else:
            unit = "m" if kind == SLIDE else "rad"
            plain.append((len(position), len(moved)))
            position.append((f"qpos.{name}", unit))
            velocity.append((f"qvel.{name}", f"{unit}/s"))
            moved.append(f"qpos.{name}")
    plain += [(len(position) + dof, len(moved) + dof) for dof in range(len(velocity))]
    columns = position + velocity
    repeated = [name for name, count in Counter(name for name, _ in columns).items() if count > 1]
    if repeated:
        raise ValueError(
            f"two columns of the state would be called {repeated[0]}: give one of the joints another name"
        )
    return StateLayout(
        names=tuple(name for name, _ in columns),
        tangent_names=(*moved, *(name for name, _ in velocity)),
        units=tuple(unit for _, unit in columns),
        quaternions=tuple(quaternions),
        plain=np.array(plain).reshape(-1, 2),
    )


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Return the joint's name, or ``joint<id>``."""
    return element_name(model, mujoco.mjtObj.mjOBJ_JOINT, joint, "joint")


def element_name(model: mujoco.MjModel, kind: mujoco.mjtObj, index: int, stem: str) -> str:
    """Return an element's name; if it has none ``<stem><id>``, with underscores where another one is called that."""
    name: str | None = mujoco.mj_id2name(model, kind, index)
    if name:
        return name
    name = f"{stem}{index}"
    while mujoco.mj_name2id(model, kind, name) >= 0:
        name += "_"
    return name


def free_name(name: str, taken: Collection[str]) -> str:
    """Return a name, with underscores where another one is called that."""
    while name in taken:
        name += "_"
    return name


def conjugate(q: Array) -> Array:
    """Return the inverse rotations of unit quaternions (..., 4)."""
    inverse: Array = q * np.array([1.0, -1.0, -1.0, -1.0])
    return inverse


def quaternion_product(p: Array, q: Array) -> Array:
    """Return the product of quaternions (..., 4): first the rotation q, then p."""
    pw, px, py, pz = np.moveaxis(p, -1, 0)
    qw, qx, qy, qz = np.moveaxis(q, -1, 0)
    parts = (
        pw * qw - px * qx - py * qy - pz * qz,
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
    )
    return np.stack(parts, axis=-1)


def rotation_vector(q: Array) -> Array:
    """Return the shortest rotation vectors (rad) of unit quaternions (..., 4)."""
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    small = sine < 1e-12
    factor = np.where(small, 2.0, 2 * np.arctan2(sine, q[..., :1]) / np.where(small, 1.0, sine))
    return factor * q[..., 1:]


def quaternion(vector: Array) -> Array:
    """Return the unit quaternions of rotation vectors (..., 3), rad."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * vector], axis=-1)
