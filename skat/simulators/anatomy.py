"""What effects need to know of a compiled model: what moves, how far, how heavy and how strong it is."""

from functools import cached_property

import mujoco
import numpy as np

from skat.simulators.channels import BALL, FREE, HINGE, SLIDE, element_name, free_name, joint_name
from skat.simulators.contacts import ContactPair, contact_pairs
from skat.simulators.edits import CAPSULE, CYLINDER
from skat.simulators.tables import Array

UNBOUNDED = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))
THINNEST = 1e-3  # m
SPHERE = int(mujoco.mjtGeom.mjGEOM_SPHERE)
JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
TENDON_TRANSMISSION = int(mujoco.mjtTrn.mjTRN_TENDON)
EXPLICIT_INTEGRATOR = int(mujoco.mjtIntegrator.mjINT_RK4)
NO_DYNAMICS, INTEGRATOR = int(mujoco.mjtDyn.mjDYN_NONE), int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
EULER = int(mujoco.mjtIntegrator.mjINT_EULER)

# Of a degree of freedom, in m or rad, over which tendons are differentiated.
SMALL_MOTION = 1e-5
# Of the strongest joint of a tree: no joint's drive is assumed to be weaker than that.
DRIVE_SHARE = 0.3
# Of a wheel's axis from its hinge's: an angle, and a distance in radii.
ALIGNED = 1e-3


class Anatomy:
    """What the effects need to know of a compiled model.

    Parameters
    ----------
    model : mujoco.MjModel
    """

    def __init__(self, model: mujoco.MjModel):
        self.model = model

    @cached_property
    def moving(self) -> list[int]:
        """Bodies that can move. A mocap body is put where it is."""
        return [body for body in range(1, self.model.nbody) if self._moves(body)]

    def _moves(self, body: int) -> bool:
        return bool(self.model.body_dofnum[self.model.body_weldid[body]])

    @cached_property
    def roots(self) -> list[int]:
        """Moving bodies that hang on one that does not."""
        return [body for body in self.moving if not self._moves(int(self.model.body_parentid[body]))]

    @cached_property
    def root(self) -> int:
        """The body on which wind and drag act: the first root with a free joint, else the first root."""
        free = [
            body
            for body in self.roots
            if any(self.joint_kind(joint) == FREE for joint in self.joints_of(body))
        ]
        return (free or self.roots)[0]

    @cached_property
    def poses(self) -> Array:
        """The reference pose and a few around it, shape (n_poses, nq)."""
        random = np.random.default_rng(0)
        poses = np.tile(self.model.qpos0, (6, 1))
        for pose in poses[1:]:
            mujoco.mj_integratePos(self.model, pose, 0.5 * random.normal(size=self.model.nv), 1.0)
        return poses

    @cached_property
    def reach(self) -> dict[int, Array]:
        """For each moving body, how much its centre of mass can move along x, y, z (0: not at all)."""
        data = mujoco.MjData(self.model)
        jacobian = np.zeros((3, self.model.nv))
        reach = {body: np.zeros(3) for body in self.moving}
        for pose in self.poses:
            data.qpos[:] = pose
            mujoco.mj_kinematics(self.model, data)
            mujoco.mj_comPos(self.model, data)
            for body in self.moving:
                mujoco.mj_jacBodyCom(self.model, data, jacobian, None, body)
                reach[body] = np.maximum(reach[body], np.abs(jacobian).max(axis=1, initial=0.0))
        return {body: np.where(reach[body] > 1e-9, reach[body], 0.0) for body in reach}

    def turned_by(self, body: int) -> list[int]:
        """Return the degrees of freedom that turn a body: those of the joints it hangs on, but for slides."""
        model, found = self.model, []
        while body:
            for joint in self.joints_of(body):
                dofs = self.dofs_of(joint)
                found += {FREE: dofs[3:], BALL: dofs, HINGE: dofs}.get(self.joint_kind(joint), [])
            body = int(model.body_parentid[body])
        return found

    @cached_property
    def soft_bodies(self) -> set[int]:
        """Bodies that are vertices of something flexible."""
        return {int(body) for body in (*self.model.flex_vertbodyid, *self.model.flex_nodebodyid)}

    def box(self, body: int) -> tuple[Array, Array]:
        """Return the corners of a box about a body's geoms and its centre of mass, along the axes of its frame, m."""
        model, turn = self.model, np.zeros(9)
        low, high = model.body_ipos[body].copy(), model.body_ipos[body].copy()
        first = int(model.body_geomadr[body])
        for geom in range(first, first + int(model.body_geomnum[body])):
            if int(model.geom_type[geom]) in UNBOUNDED:
                continue
            mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
            axes = turn.reshape(3, 3)
            middle = model.geom_pos[geom] + axes @ model.geom_aabb[geom, :3]
            reach = np.abs(axes) @ model.geom_aabb[geom, 3:]
            low, high = np.minimum(low, middle - reach), np.maximum(high, middle + reach)
        # A body without geoms is as large as its inertia says.
        size = (
            0.0
            if model.body_geomnum[body]
            else float(np.sqrt(model.body_inertia[body].sum() / max(float(model.body_mass[body]), 1e-9)))
        )
        grow = np.maximum((max(size, THINNEST) - (high - low)) / 2, 0.0)
        return low - grow, high + grow

    def rims_of(self, body: int) -> tuple[int, ...]:
        """Return the geoms that a wheel rolls on: a body that turns without end about one hinge, () for any other.

        They are all that touches others, also on bodies welded to it; each is round and centred about the hinge.
        """
        model, joints = self.model, self.joints_of(body)
        if len(joints) != 1 or self.joint_kind(joints[0]) != HINGE or model.jnt_limited[joints[0]]:
            return ()
        touching = {geom for pair in self.pairs for geom in (pair.first, pair.second)}
        rims = sorted(
            geom for geom in touching if model.body_weldid[model.geom_bodyid[geom]] == model.body_weldid[body]
        )
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)

        def turns_in_itself(geom: int) -> bool:
            axis, radius = data.xaxis[joints[0]], model.geom_size[geom, 0]
            off = np.cross(data.geom_xpos[geom] - data.xanchor[joints[0]], axis)
            askew = np.cross(data.geom_xmat[geom].reshape(3, 3)[:, 2], axis)
            kind = int(model.geom_type[geom])
            aligned = kind in (CAPSULE, CYLINDER) and np.linalg.norm(askew) < ALIGNED
            return bool((kind == SPHERE or aligned) and np.linalg.norm(off) < ALIGNED * radius)

        return tuple(rims) if all(map(turns_in_itself, rims)) else ()

    @cached_property
    def pairs(self) -> tuple[ContactPair, ...]:
        """Pairs of geoms that can touch."""
        return contact_pairs(self.model)

    def body_name(self, body: int) -> str:
        """Return the body's name, or ``body<id>``."""
        return element_name(self.model, mujoco.mjtObj.mjOBJ_BODY, body, "body")

    def joint_kind(self, joint: int) -> int:
        """Return the joint's type."""
        return int(self.model.jnt_type[joint])

    def joints_of(self, body: int) -> list[int]:
        """Return the joints of a body."""
        first = int(self.model.body_jntadr[body])
        return list(range(first, first + int(self.model.body_jntnum[body])))

    def dofs_of(self, joint: int) -> list[int]:
        """Return the degrees of freedom of a joint."""
        count = {FREE: 6, BALL: 3}.get(self.joint_kind(joint), 1)
        first = int(self.model.jnt_dofadr[joint])
        return list(range(first, first + count))

    @cached_property
    def joint_driven(self) -> list[int]:
        """Actuators that act through a joint."""
        return np.flatnonzero(np.isin(self.model.actuator_trntype, JOINT_TRANSMISSIONS)).tolist()

    @cached_property
    def actuated(self) -> set[int]:
        """Joints that an actuator drives."""
        return {int(joint) for joint in self.model.actuator_trnid[self.joint_driven, 0]}

    @cached_property
    def drives(self) -> list[list[int]]:
        """Actuators that act on each degree of freedom through its joint."""
        model = self.model
        drives: list[list[int]] = [[] for _ in range(model.nv)]
        for actuator in self.joint_driven:
            dofs = self.dofs_of(int(model.actuator_trnid[actuator, 0]))
            for dof, gear in zip(dofs, model.actuator_gear[actuator]):
                if gear:
                    drives[dof].append(actuator)
        return drives

    @cached_property
    def base_joints(self) -> set[int]:
        """Joints that only say where the robot is: those of a planar floating base, and free joints."""
        found: set[int] = set()
        for body in self.roots:
            joints = self.joints_of(body)
            kinds = [self.joint_kind(joint) for joint in joints]
            carries = (
                self.model.body_treeid[body]
                in self.model.body_treeid[
                    [
                        int(self.model.jnt_bodyid[joint])
                        for joint in range(self.model.njnt)
                        if joint not in joints
                    ]
                ]
            )
            planar = len(joints) > 1 and SLIDE in kinds and carries and not self.actuated & set(joints)
            if FREE in kinds or planar:
                found |= set(joints)
        return found

    @cached_property
    def inertia(self) -> Array:
        """Inertia of each degree of freedom in the reference pose, kg or kg m2."""
        inertia: Array = np.maximum(self.model.dof_M0, 1e-6)
        return inertia

    @cached_property
    def force(self) -> Array:
        """Characteristic force or torque of each degree of freedom: of gravity, of actuators, of 1 g."""
        model, data = self.model, mujoco.MjData(self.model)
        force = 10 * self.inertia
        for pose in self.poses:
            data.qpos[:] = pose
            mujoco.mj_forward(model, data)
            force = np.maximum(force, np.abs(data.qfrc_bias))
        for actuator in self.joint_driven:
            joint = int(model.actuator_trnid[actuator, 0])
            if self.joint_kind(joint) in (HINGE, SLIDE):
                dof = int(model.jnt_dofadr[joint])
                force[dof] = max(force[dof], self.capacity(actuator))
        return force

    @cached_property
    def strength(self) -> Array:
        """Force or torque that the drive of each degree of freedom may have: at least a share of its tree's strongest.

        A motor's limit may be unknown, and the gravity on a wrist is no measure of the drive in it.
        """
        straight = np.isin(self.model.jnt_type[self.model.dof_jntid], (SLIDE, FREE))
        trees = self.model.dof_treeid
        strength = self.force.copy()
        for tree in np.unique(trees):
            for kind in (True, False):
                members = (trees == tree) & (straight == kind)
                if members.any():
                    strength[members] = np.maximum(strength[members], DRIVE_SHARE * self.force[members].max())
        return strength

    def is_off(self, flag: str) -> bool:
        """Whether the model disables a part of MuJoCo's pipeline, by the name of its flag."""
        return bool(
            self.model.opt.disableflags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag.upper()}"))
        )

    @property
    def damps_explicitly(self) -> bool:
        """Whether Euler's integrator is told to treat the damping of joints as it does what actuators do."""
        return int(self.model.opt.integrator) == EULER and self.is_off("eulerdamp")

    @cached_property
    def stable_rate(self) -> Array:
        """Largest damping that the integrator bears on each degree of freedom, force per velocity."""
        if not self.damps_explicitly and int(self.model.opt.integrator) != EXPLICIT_INTEGRATOR:
            return np.full(self.model.nv, np.inf)
        rate: Array = 1 / (self.model.opt.timestep * np.maximum(self.model.dof_invweight0, 1e-9))
        return rate

    @cached_property
    def tendon_ranges(self) -> tuple[Array, Array]:
        """Of each tendon, over the poses: the largest inverse of the mass that it moves, and the range of its length.

        In a single pose it may pass through the axis of its joint, where it moves nothing.
        """
        model, data = self.model, mujoco.MjData(self.model)
        mobility, length = np.zeros(model.ntendon), np.zeros((len(self.poses), model.ntendon))
        for pose, lengths in zip(self.poses, length):
            data.qpos[:] = pose
            mujoco.mj_forward(model, data)
            lengths[:] = data.ten_length
            slopes = self._tendon_slopes(pose)
            accelerations = np.zeros_like(slopes)
            mujoco.mj_solveM(model, data, accelerations, slopes)
            mobility = np.maximum(mobility, np.sum(slopes * accelerations, axis=1))
        return mobility, np.ptp(length, axis=0)

    def _tendon_slopes(self, pose: Array) -> Array:
        """Return derivatives (n_tendons, nv) of the lengths of tendons by motions away from a pose."""
        model, data = self.model, mujoco.MjData(self.model)
        slopes = np.zeros((model.ntendon, model.nv))
        for dof in range(model.nv):
            for sign in (1.0, -1.0):
                data.qpos[:] = pose
                mujoco.mj_integratePos(model, data.qpos, np.eye(model.nv)[dof], sign * SMALL_MOTION)
                mujoco.mj_forward(model, data)
                slopes[:, dof] += sign * data.ten_length / (2 * SMALL_MOTION)
        return slopes

    def tendon_force(self, tendon: int) -> float:
        """Return the characteristic force of a tendon: of its actuators, or of 1 g on the mass that it moves."""
        model = self.model
        pulled = (model.actuator_trntype == TENDON_TRANSMISSION) & (model.actuator_trnid[:, 0] == tendon)
        weight = 10 / float(self.tendon_ranges[0][tendon])
        return max([weight, *(self.capacity(int(actuator)) for actuator in np.flatnonzero(pulled))])

    @cached_property
    def actuator_mobility(self) -> Array:
        """Of each actuator, over the poses: the largest inverse of the mass that its force moves, its gear included."""
        model, data = self.model, mujoco.MjData(self.model)
        moments = np.zeros((len(data.moment_rownnz), model.nv))
        accelerations, mobility = np.zeros_like(moments), np.zeros(len(moments))
        for pose in self.poses:
            data.qpos[:] = pose
            mujoco.mj_forward(model, data)
            sparse = data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
            mujoco.mju_sparse2dense(moments, *sparse)
            mujoco.mj_solveM(model, data, accelerations, moments)
            mobility = np.maximum(mobility, np.sum(moments * accelerations, axis=1))
        of_each: Array = mobility[model.actuator_outadr]
        return of_each

    def largest_control(self, actuator: int) -> float:
        """Return the size of the largest control of an actuator; 1 if nothing limits it."""
        limited = bool(self.model.actuator_ctrllimited[actuator])
        return float(np.abs(self.model.actuator_ctrlrange[actuator]).max()) if limited else 1.0

    def capacity(self, actuator: int) -> float:
        """Return the largest force of an actuator on its joint or tendon.

        Its limit, if it has one; else that at the largest control, or at a control of 1.
        """
        model = self.model
        force = abs(float(model.actuator_gainprm[actuator, 0])) * self.largest_control(actuator)
        if model.actuator_forcelimited[actuator]:
            force = float(np.abs(model.actuator_forcerange[actuator]).max())
        return abs(float(model.actuator_gear[actuator, 0])) * force


def tendon_name(model: mujoco.MjModel, tendon: int) -> str:
    """Return the tendon's name, or ``tendon<id>``."""
    return element_name(model, mujoco.mjtObj.mjOBJ_TENDON, tendon, "tendon")


def actuator_name(model: mujoco.MjModel, actuator: int) -> str:
    """Return the actuator's name; if it has none the name of its joint; else ``actuator<id>``."""
    own: list[str] = [model.actuator(index).name for index in range(model.nu)]
    if own[actuator]:
        return own[actuator]

    def joint_of(index: int) -> str:
        if own[index] or int(model.actuator_trntype[index]) not in JOINT_TRANSMISSIONS:
            return ""
        return joint_name(model, int(model.actuator_trnid[index, 0]))

    name = joint_of(actuator)
    taken = own + [joint_of(index) for index in range(model.nu) if index != actuator]
    if name and name not in taken:
        return name
    return free_name(f"actuator{actuator}", taken)


def drag_joint(anatomy: Anatomy, axis: int) -> int | None:
    """Return the slide joint whose quadratic damping is the root's air drag along a world axis.

    None if there is none: the root turns, or several slides move it along this axis.
    """
    joints = anatomy.joints_of(anatomy.root)
    if not all(anatomy.joint_kind(joint) == SLIDE for joint in joints):
        return None
    data = mujoco.MjData(anatomy.model)
    mujoco.mj_kinematics(anatomy.model, data)
    shares = np.abs(data.xaxis[joints, axis])
    along = np.flatnonzero(shares > 1e-12)
    return joints[along[0]] if len(along) == 1 and abs(shares[along[0]] - 1) < 1e-12 else None
