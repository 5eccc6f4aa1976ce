"""Edits of a MjSpec that express effects: masses, lengths, joints, actuators, gravity, the time step.

Bodies, geoms, joints and actuators are meant by their index in the spec's lists, which copies keep. Each edit
changes the spec in place; a list of indices means the edit of each.
"""

import copy
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

CAPSULE, CYLINDER = int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER)
FROM_GEOMS = int(mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE)
AUTOMATIC = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
# What is put behind the name of a joint for that of its play.
PLAY = ".play"
SHELL = mujoco.mjtGeomInertia.mjINERTIA_SHELL
EULERDAMP = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
IMPLICIT = mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
ONE_AXIS = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
PLAIN_GAINS = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtGain.mjGAIN_AFFINE
PLAIN_BIASES = mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE
# All that the compiler reads of a joint, but for its frame.
JOINT_PARTS = (
    *("name", "type", "pos", "axis", "ref", "align", "stiffness", "springref", "springdamper", "springyield"),
    *("limited", "range", "margin", "solref_limit", "solimp_limit", "actfrclimited", "actfrcrange"),
    *("actgravcomp", "armature", "damping", "frictionloss", "solref_friction", "solimp_friction", "group"),
)


def scale_mass(bodies: Sequence[int], spec: mujoco.MjSpec, factor: float) -> None:
    """Multiply the mass of bodies, and their inertia with it; what compensates their gravity stays what it was."""
    multiply_mass(bodies, spec, factor)
    for body in _bodies(spec, bodies):
        body.gravcomp = body.gravcomp / factor


def multiply_mass(bodies: Sequence[int], spec: mujoco.MjSpec, factor: float) -> None:
    """Multiply the mass of bodies, and their inertia with it, as the compiler does for a total mass."""
    for body in _bodies(spec, bodies):
        body.mass = body.mass * factor
        body.inertia = body.inertia * factor
        body.fullinertia = body.fullinertia * factor
        for geom in body.geoms:
            if math.isnan(geom.mass):
                geom.density = geom.density * factor
            else:
                geom.mass = geom.mass * factor


def scale_length(
    meshes: Mapping[str, np.ndarray], bodies: Sequence[int], spec: mujoco.MjSpec, factor: float
) -> None:
    """Stretch links about the hinge or ball joint that carries each, so that no other link changes its length.

    Places along a link are multiplied: of child bodies' joints, geoms, sites, and ends of capsules and cylinders;
    about the body's frame where nothing turns it. Radii and other sizes stay. So does the mass; the inertia follows
    from the geoms. Where a body's inertia is given explicitly, it is multiplied by the factor squared, as for a thin
    rod. `meshes` holds the centre of each mesh, where the compiler puts the geom that has it.
    """
    moves = []
    for body in _bodies(spec, bodies):
        moves.append((body, (1 - factor) * _carrier(body, spec)))
        moves += [(child, (factor - 1) * _carrier(child, spec)) for child in body.bodies]
    for body in _bodies(spec, bodies):
        for part in [*body.bodies, *body.joints, *body.sites, *body.frames]:
            part.pos = part.pos * factor
        body.ipos = body.ipos * factor
        body.inertia = body.inertia * factor**2
        body.fullinertia = body.fullinertia * factor**2
        for geom in body.geoms:
            geom.pos = geom.pos * factor
            if geom.meshname:
                geom.pos = geom.pos + (factor - 1) * _turned(meshes[geom.meshname], geom, spec)
            elif int(geom.type) in (CAPSULE, CYLINDER):
                _lengthen(geom, factor)
            elif not math.isnan(geom.fromto[0]):
                geom.fromto = geom.fromto + (factor - 1) * np.tile((geom.fromto[:3] + geom.fromto[3:]) / 2, 2)
    # A frame that is not at its joint is in the middle of its link, or beside it: what stays is the joint.
    for body, move in moves:
        body.pos = body.pos + move


def scale_radius(
    rims: Mapping[int, Sequence[int]], bodies: Sequence[int], spec: mujoco.MjSpec, factor: float
) -> None:
    """Multiply the radius of wheels, that is of the geoms that each rolls on; mass and inertia stay.

    A geom that the compiler fits to a mesh is scaled as a whole.
    """
    for geom in [geom for body in bodies for geom in rims[body]]:
        element = spec.geoms[geom]
        _with_inertial(element.parent, spec)
        if element.meshname:
            element.fitscale = element.fitscale * factor
        else:
            element.size[0] = element.size[0] * factor


def scale_inertia(body: int, spec: mujoco.MjSpec, factor: float) -> None:
    """Multiply a body's inertia about its centre of mass; the mass and the centre stay."""
    element = _with_inertial(spec.bodies[body], spec)
    element.inertia = element.inertia * factor
    element.fullinertia = element.fullinertia * factor


def shift_centre_of_mass(body: int, axis: int, spec: mujoco.MjSpec, shift: float) -> None:
    """Move a body's centre of mass in the body's frame; the mass and the inertia about it stay."""
    element = _with_inertial(spec.bodies[body], spec)
    element.ipos[axis] = element.ipos[axis] + shift


def heed_inertials(spec: mujoco.MjSpec) -> None:
    """Have the compiler heed the inertia that is given to a body, and let none be given that it did not heed before.

    With ``inertiafromgeom="true"`` it takes all from the geoms.
    """
    if int(spec.compiler.inertiafromgeom) != FROM_GEOMS:
        return
    spec.compiler.inertiafromgeom = AUTOMATIC
    for body in spec.bodies:
        body.explicitinertial = False
        if body.geoms:
            body.mass, body.inertia = 0.0, np.zeros(3)
            body.ipos, body.fullinertia = np.full(3, np.nan), np.full(6, np.nan)


def scale_gravity(spec: mujoco.MjSpec, factor: float) -> None:
    """Multiply gravity."""
    spec.option.gravity = np.asarray(spec.option.gravity) * factor


def tilt_gravity(axis: int, spec: mujoco.MjSpec, angle: float) -> None:
    """Turn gravity so that (0, 0, -g) becomes g sin(angle) along the axis and -g cos(angle) along z."""
    gravity = np.array(spec.option.gravity)
    along, down = gravity[axis], gravity[2]
    gravity[axis] = math.cos(angle) * along - math.sin(angle) * down
    gravity[2] = math.sin(angle) * along + math.cos(angle) * down
    spec.option.gravity = gravity


def add_damping(joints: Sequence[int], spec: mujoco.MjSpec, value: float) -> None:
    """Add linear damping."""
    for joint in _joints(spec, joints):
        joint.damping[0] = joint.damping[0] + value


def add_quadratic_damping(joints: Sequence[int], spec: mujoco.MjSpec, value: float) -> None:
    """Add damping that grows with the square of the velocity."""
    for joint in _joints(spec, joints):
        joint.damping[1] = joint.damping[1] + value


def add_dry_friction(joints: Sequence[int], spec: mujoco.MjSpec, value: float) -> None:
    """Add dry friction."""
    for joint in _joints(spec, joints):
        joint.frictionloss = joint.frictionloss + value


def add_armature(joints: Sequence[int], spec: mujoco.MjSpec, value: float) -> None:
    """Add armature, the inertia of a geared rotor."""
    for joint in _joints(spec, joints):
        joint.armature = joint.armature + value


def add_stiffness(joints: Sequence[int], spec: mujoco.MjSpec, value: float) -> None:
    """Add stiffness about the joint's spring reference."""
    for joint in _joints(spec, joints):
        joint.stiffness[0] = joint.stiffness[0] + value


def add_tendon_damping(tendon: int, spec: mujoco.MjSpec, value: float) -> None:
    """Add linear damping to a tendon."""
    element = spec.tendons[tendon]
    element.damping[0] = element.damping[0] + value


def add_tendon_friction(tendon: int, spec: mujoco.MjSpec, value: float) -> None:
    """Add dry friction to a tendon."""
    element = spec.tendons[tendon]
    element.frictionloss = element.frictionloss + value


def add_tendon_stiffness(tendon: int, spec: mujoco.MjSpec, value: float) -> None:
    """Add stiffness to a tendon, about its spring's resting length."""
    element = spec.tendons[tendon]
    element.stiffness[0] = element.stiffness[0] + value


def scale_gain(actuators: Sequence[int], spec: mujoco.MjSpec, factor: float) -> None:
    """Multiply the force of actuators, also the part of it that does not depend on the control."""
    elements = spec.actuators
    for index in actuators:
        actuator = elements[index]
        actuator.gainprm = np.asarray(actuator.gainprm) * factor
        actuator.biasprm = np.asarray(actuator.biasprm) * factor
        _keep_velocity_gain(actuator)


def scale_stiffness_of_servo(actuators: Sequence[int], spec: mujoco.MjSpec, factor: float) -> None:
    """Multiply the position gain of servos, and leave their damping as it is."""
    elements = spec.actuators
    for index in actuators:
        actuator = elements[index]
        actuator.gainprm[0] = actuator.gainprm[0] * factor
        actuator.biasprm[1] = actuator.biasprm[1] * factor
        _keep_velocity_gain(actuator)


def scale_velocity_gain_of_servo(actuators: Sequence[int], spec: mujoco.MjSpec, factor: float) -> None:
    """Multiply the velocity feedback of servos, and leave their position gain as it is."""
    elements = spec.actuators
    for index in actuators:
        elements[index].biasprm[2] = elements[index].biasprm[2] * factor


def scale_force_limit(actuators: Sequence[int], spec: mujoco.MjSpec, factor: float) -> None:
    """Multiply both ends of actuators' range of force."""
    elements = spec.actuators
    for index in actuators:
        elements[index].forcerange = np.asarray(elements[index].forcerange) * factor


def offset_command(actuator: int, spec: mujoco.MjSpec, offset: float) -> None:
    """Let a servo act as if its control were larger."""
    element = spec.actuators[actuator]
    element.biasprm[0] = element.biasprm[0] + element.gainprm[0] * offset


def delay_actuators(actuators: Sequence[int], spec: mujoco.MjSpec, delay: float) -> None:
    """Delay actuators' controls, on top of the delay they have; linear between the time steps if they have none."""
    elements = spec.actuators
    for index in actuators:
        actuator = elements[index]
        if not actuator.delay:
            actuator.interp = 1
        actuator.delay = actuator.delay + delay
        actuator.nsample = math.ceil(actuator.delay / spec.option.timestep - 1e-9) + 1


def filter_commands(actuators: Sequence[int], spec: mujoco.MjSpec, lag: float) -> None:
    """Put a filter of first order between actuators and their controls, or a slower one in its place.

    MuJoCo's acts as it is at the end of a time step, half a step early; its time constant is such that it comes as
    late, in the mean, as is asked for.
    """
    elements, step = spec.actuators, float(spec.option.timestep)
    for index in actuators:
        actuator = elements[index]
        # Without dynamics MuJoCo's default of a time constant is 1 s, and means nothing.
        is_same = actuator.actearly and actuator.dyntype == mujoco.mjtDyn.mjDYN_FILTEREXACT
        own = actuator.dynprm[0] if is_same else 0.0
        total = lag + (step / math.expm1(step / own) if own else 0.0)
        actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        actuator.dynprm[0] = step / math.log1p(step / total) if total else 0.0
        actuator.actearly = True


def scale_command(actuator: int, spec: mujoco.MjSpec, factor: float) -> None:
    """Let an actuator act as if its control were multiplied."""
    element = spec.actuators[actuator]
    element.gainprm = np.asarray(element.gainprm) * factor
    if factor:
        _move_ranges_of_commands(element, lambda limits: np.sort(limits / factor))


def shift_command(actuator: int, spec: mujoco.MjSpec, bias: float) -> None:
    """Let an actuator act as if its control were larger."""
    element = spec.actuators[actuator]
    element.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    element.biasprm[0] = element.biasprm[0] + element.gainprm[0] * bias
    _move_ranges_of_commands(element, lambda limits: limits - bias)


def _move_ranges_of_commands(actuator: mujoco.MjsActuator, moved: Callable[[np.ndarray], np.ndarray]) -> None:
    """Change the ranges of a control, and of what a filter holds of it, where they are in force."""
    if is_limited(actuator.ctrllimited, actuator.ctrlrange):
        actuator.ctrlrange = moved(np.asarray(actuator.ctrlrange))
    if is_limited(actuator.actlimited, actuator.actrange):
        actuator.actrange = moved(np.asarray(actuator.actrange))


def limit_force(actuator: int, spec: mujoco.MjSpec, force: float) -> None:
    """Let an actuator have at most this force."""
    element = spec.actuators[actuator]
    element.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    element.forcerange = [-force, force]


def prepare_tiring(actuator: int, control: float, spec: mujoco.MjSpec, slope: float) -> None:
    """Give an actuator without a limit of its force one for its speed to lower: what it has at a control."""
    element = spec.actuators[actuator]
    force = abs(float(element.gainprm[0])) * control
    if force and not is_limited(element.forcelimited, element.forcerange):
        limit_force(actuator, spec, force)


def prepare_lag(actuator: int, spec: mujoco.MjSpec, lag: float) -> None:
    """Give an actuator a bias for the stepping to write its late force into."""
    spec.actuators[actuator].biastype = mujoco.mjtBias.mjBIAS_AFFINE


def add_play(joint: str, rotor: float, spec: mujoco.MjSpec, width: float) -> None:
    """Put a joint with play between a joint's motor, which keeps its armature and friction, and the link.

    A motor without inertia gets `rotor`. Keyframes, which do not know of this joint, go. `finish_plays` does what waits
    for all other edits.
    """
    motor = next(one for one in spec.joints if one.name == joint)
    if motor.armature <= 0:
        motor.armature = rotor
    play = motor.parent.add_joint(
        name=joint + PLAY,
        type=motor.type,
        pos=motor.pos,
        axis=motor.axis,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        range=_in_units(spec, motor, [-width / 2, width / 2]),
        solimp_limit=[0.95, 0.99, 1e-4, 0.5, 2.0],
        armature=0.0,
        damping=np.zeros_like(motor.damping),
        stiffness=np.zeros_like(motor.stiffness),
        frictionloss=0.0,
        margin=0.0,
        # What the model's default for joints would give it.
        ref=0.0,
        springdamper=np.zeros(2),
        actfrclimited=mujoco.mjtLimited.mjLIMITED_FALSE,
    )
    if motor.frame is not None:
        play.set_frame(motor.frame)
    _follow(motor, play)
    for key in list(spec.keys):
        spec.delete(key)


def finish_plays(joints: Collection[str], spec: mujoco.MjSpec, shares: Mapping[int, float]) -> bool:
    """Make the flanks of joints' plays hard, and have them stop motors with their dampers, once the time step h is set.

    Flanks are as hard as the time step allows. An implicit integrator solves (M + h D) a = f, but its constraints know
    M alone: to a flank a small rotor with a strong servo, h D >> M, is as good as nothing, and the link goes on
    through it. Here h D is written into the armatures, and D is explicit: without constraints the same equation, and
    with them one that they know. That needs a D of joints alone (dampers, speed feedback of actuators on hinges and
    slides); otherwise it stays as it is. Returned is whether it does not. `shares` says of actuators, by index, how
    much of the force acts within a time step, where it is late.

    A servo at the limit of its force feeds nothing back, and of its h D the integrator then knows nothing, while an
    armature stays. So where limits cut servos off it stays as it is, too, unless a rotor with play is lighter than
    its h D: then the flanks would not hold it, which is wrong at each blow and not at the limit alone.
    """
    step, plays = spec.option.timestep, {name + PLAY for name in joints}
    for joint in spec.joints:
        if joint.name in plays:
            joint.solref_limit = [2 * step, 1.0]
    euler = spec.option.integrator == mujoco.mjtIntegrator.mjINT_EULER
    if (euler and spec.option.disableflags & EULERDAMP) or not (euler or spec.option.integrator in IMPLICIT):
        return False
    feedback: dict[str, float] = {}  # a joint that is driven has a name, others may share none
    hinges = {joint.name for joint in spec.joints if joint.type in ONE_AXIS}
    weak = {one.name for one in spec.joints if is_limited(one.actfrclimited, one.actfrcrange)}
    cut_off = False
    among = spec.option.viscosity or spec.option.density or any(np.any(one.damping) for one in spec.tendons)
    for index, actuator in enumerate(() if euler else spec.actuators):
        affine = actuator.gaintype in PLAIN_GAINS and actuator.biastype in PLAIN_BIASES
        rate = -float(actuator.biasprm[2]) if actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE else 0.0
        of_joint = actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT and actuator.target in hinges
        if not affine or actuator.gainprm[2] or (rate and not of_joint):
            among = True
        elif rate:
            own = float(actuator.gear[0]) ** 2 * rate * shares.get(index, 1.0)
            feedback[actuator.target] = feedback.get(actuator.target, 0.0) + own
            cut_off |= is_limited(actuator.forcelimited, actuator.forcerange) or actuator.target in weak
    hidden = [step * (float(joint.damping[0]) + feedback.get(joint.name, 0.0)) for joint in spec.joints]
    rotors = [(joint.armature, own) for joint, own in zip(spec.joints, hidden) if joint.name in joints]
    if among or (cut_off and all(armature >= own for armature, own in rotors)):
        return False
    for joint, own in zip(spec.joints, hidden):
        joint.armature += own
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.disableflags |= EULERDAMP
    return True


def _follow(first: mujoco.MjsJoint, last: mujoco.MjsJoint) -> None:
    """Have the last joint of a body come right after another; those in between move on by a place.

    A joint turns the axes of those that follow it in its body.
    """
    joints = list(first.parent.joints)
    places = joints[[one.name for one in joints].index(first.name) + 1 :]
    if len(places) < 2:
        return
    moved = [last, *places[:-1]]
    parts = [{name: copy.copy(getattr(one, name)) for name in JOINT_PARTS} for one in moved]
    frames = [one.frame or first.parent.add_frame() for one in moved]
    for place in places:
        place.name = ""  # which no two may share at any time
    for place, frame, values in zip(places, frames, parts):
        place.set_frame(frame)
        for name, value in values.items():
            setattr(place, name, value)


def is_limited(flag: int, limits: Sequence[float]) -> bool:
    """Return whether a range is in force, as the compiler decides it of a flag that may be left to the range."""
    automatic = flag == mujoco.mjtLimited.mjLIMITED_AUTO and limits[0] < limits[1]
    return bool(flag == mujoco.mjtLimited.mjLIMITED_TRUE or automatic)


def _in_units(spec: mujoco.MjSpec, joint: mujoco.MjsJoint, values: Sequence[float]) -> np.ndarray:
    """Return angles as the compiler reads them."""
    turns = joint.type == mujoco.mjtJoint.mjJNT_HINGE and spec.compiler.degree
    return np.rad2deg(values) if turns else np.asarray(values)


def add_payload(body: int, place: Sequence[float | None], spec: mujoco.MjSpec, mass: float) -> None:
    """Fix a point mass to a body, at a place in the body's frame; nothing compensates its gravity.

    None along an axis: where the body's centre of mass is.
    """
    element = _with_inertial(spec.bodies[body], spec)
    turn, diagonal = np.zeros(9), np.array(element.inertia, dtype=float)
    if np.isnan(element.fullinertia[0]):
        mujoco.mju_quat2Mat(turn, orientation(element.iquat, element.ialt, element.compiler, spec))
        axes = turn.reshape(3, 3)
        inertia = axes @ np.diag(diagonal) @ axes.T
    else:
        xx, yy, zz, xy, xz, yz = element.fullinertia
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    own, total = float(element.mass), float(element.mass) + mass
    offset = np.array([0.0 if at is None else at - centre for at, centre in zip(place, element.ipos)])
    reduced = own * mass / total
    inertia = inertia + reduced * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    element.ipos = element.ipos + mass / total * offset
    element.mass, element.gravcomp = total, element.gravcomp * own / total
    element.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    element.iquat = [1.0, 0.0, 0.0, 0.0]
    element.inertia = np.zeros(3)
    element.fullinertia = [*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]


def scale_timestep(spec: mujoco.MjSpec, factor: float) -> None:
    """Multiply the time step."""
    spec.option.timestep = spec.option.timestep * factor


def _keep_velocity_gain(actuator: mujoco.MjsActuator) -> None:
    """Keep the compiler from taking a positive velocity feedback for a damping ratio.

    It does not where the first two parameters differ, if by no more than rounding.
    """
    if actuator.biasprm[2] > 0 and actuator.gainprm[0] == -actuator.biasprm[1]:
        actuator.gainprm[0] = np.nextafter(actuator.gainprm[0], np.inf)


def _carrier(body: mujoco.MjsBody, spec: mujoco.MjSpec) -> np.ndarray:
    """Return the place of the first joint that turns a body, from the body's frame, along the axes of its ``pos``."""
    for joint in body.joints:
        if joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_BALL):
            place, frame = joint.pos, joint.frame
            while frame is not None:
                place, frame = frame.pos + _turned(place, frame, spec), frame.frame
            return _turned(place, body, spec)
    return np.zeros(3)


def _turned(place: np.ndarray, element: Any, spec: mujoco.MjSpec) -> np.ndarray:
    """Return a place in a body's, frame's or geom's frame along the axes that the element itself is placed in."""
    quaternion, turned = orientation(element.quat, element.alt, element.compiler, spec), np.zeros(3)
    mujoco.mju_rotVecQuat(turned, np.asarray(place, dtype=float), quaternion)
    return turned


def orientation(given: np.ndarray, other: Any, compiler: Any, spec: mujoco.MjSpec) -> np.ndarray:
    """Return an orientation, given as a quaternion or in another way, as a unit quaternion."""
    if other.type == mujoco.mjtOrientation.mjORIENTATION_QUAT:
        return np.asarray(given / np.linalg.norm(given))
    found = spec.resolve_orientation(degree=compiler.degree, sequence=compiler.eulerseq, orientation=other)
    return np.array(found)


def _lengthen(geom: mujoco.MjsGeom, factor: float) -> None:
    """Multiply the distance of the ends of a capsule or cylinder, at constant mass."""
    if math.isnan(geom.fromto[0]):
        length = 2 * float(geom.size[1])
        geom.size[1] = geom.size[1] * factor
    else:
        length = float(np.linalg.norm(geom.fromto[3:] - geom.fromto[:3]))
        geom.fromto = geom.fromto * factor
    if math.isnan(geom.mass):
        # The ends weigh as much as so much more of the length.
        ends = {(CAPSULE, False): 4 / 3, (CAPSULE, True): 2.0, (CYLINDER, False): 0.0, (CYLINDER, True): 1.0}
        caps = ends[int(geom.type), geom.typeinertia == SHELL] * float(geom.size[0])
        geom.density = geom.density * (length + caps) / (length * factor + caps)


def _with_inertial(body: mujoco.MjsBody, spec: mujoco.MjSpec) -> mujoco.MjsBody:
    """Return a body whose mass, centre of mass and inertia are its own numbers, no longer those of its geoms."""
    heed_inertials(spec)
    if not body.explicitinertial:
        spec.adopt_inertial(body)
    return body


def _bodies(spec: mujoco.MjSpec, indices: Sequence[int]) -> Iterator[mujoco.MjsBody]:
    elements = spec.bodies
    return (elements[index] for index in indices)


def _joints(spec: mujoco.MjSpec, indices: Sequence[int]) -> Iterator[mujoco.MjsJoint]:
    elements = spec.joints
    return (elements[index] for index in indices)
