"""A mechanism as described by a simulator's file, and its fittable numbers.

It has bodies, joints, tendons, actuators and sensors. All of them are plain frozen values, which
need no simulator. Everything is SI and radians, in the frames and with the names of the file. In a
name that is not a plain word, signs become "_". An element without a name is called by its kind and
number. Body 0 is the world. Places and axes are (3,), quaternions (w, x, y, z).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pamid.model.parameter import Parameter

Vector = tuple[float, ...]
Range = tuple[float, float]


@dataclass(frozen=True)
class Body:
    """A rigid body.

    position, quaternion        of its frame in its parent's
    centre, inertia_quaternion  of its principal axes in the body's frame
    inertia                     kg m2 about these axes
    gravity_compensation        share of its weight that an upward force at its centre carries
    """

    name: str
    parent: int
    position: Vector
    quaternion: Vector
    mass_kg: float
    centre: Vector
    inertia_quaternion: Vector
    inertia: Vector
    gravity_compensation: float = 0.0

    def scaled(self, mass_kg: float) -> Body:
        """The same shape with another mass."""
        ratio = mass_kg / self.mass_kg if self.mass_kg else 1.0
        inertia = tuple(ratio * v for v in self.inertia)
        return replace(self, mass_kg=mass_kg, inertia=inertia)


@dataclass(frozen=True)
class MechanismJoint:
    """A hinge (rad, N m) or a slide (m, N) at `anchor` along `axis`, both in the body's frame.

    The joints of a body follow each other.

    line             in the file, 0 if unknown
    reference        position of the joint in the file's pose
    spring_reference position at which the spring is relaxed
    friction_rate, friction_softness  1/s, and relative to the inverse inertia: onset of the
                     friction, see `pamid.rigs.simulators.soft_constraints`
    typical_inertia  about the joint at the reference, kg m2 or kg
    range, force_range  None: without limits
    qpos, dof        places among the simulator's positions and velocities
    damping_powers   (b, c) of a damper a v + b v|v| + c v^3, whose a is `damping`
    stiffness_powers (b, c) of a spring a x + b x^2 + c x^3, whose a is `stiffness`
    spring_yield     deflection beyond which the spring yields for good; 0: never
    compensated_by_actuator  gravity compensation counts as a force of its actuators
    is_base          for a joint that replaces a free joint: nothing but the motion itself
    """

    name: str
    kind: str
    body: int
    axis: Vector
    anchor: Vector
    reference: float
    spring_reference: float
    stiffness: float
    damping: float
    friction_loss: float
    friction_rate: float
    friction_softness: float
    armature: float
    typical_inertia: float
    range: Range | None = None
    force_range: Range | None = None
    line: int = 0
    qpos: int = 0
    dof: int = 0
    damping_powers: Vector = (0.0, 0.0)
    stiffness_powers: Vector = (0.0, 0.0)
    spring_yield: float = 0.0
    compensated_by_actuator: bool = False
    is_base: bool = False

    @property
    def spring_state(self) -> str:
        """Name of the state of a yielding spring: its relaxed position."""
        return f"{self.name}_spring_reference" if self.spring_yield else ""

    @property
    def unit(self) -> str:
        return "rad" if self.kind == "hinge" else "m"

    @property
    def force_unit(self) -> str:
        return "N m" if self.kind == "hinge" else "N"


@dataclass(frozen=True)
class MechanismTendon:
    """A fixed tendon, whose length is the sum of coefficient times joint position.

    rest: lengths between which its spring is relaxed; powers: as those of a joint.
    """

    name: str
    joints: tuple[int, ...]
    coefficients: Vector
    stiffness: float
    damping: float
    friction_loss: float
    rest: Range
    damping_powers: Vector = (0.0, 0.0)
    stiffness_powers: Vector = (0.0, 0.0)


@dataclass(frozen=True)
class Coupling:
    """y - y0 = polynomial(x - x0) between the positions of two joints, or the lengths of two
    tendons.

    It is soft: see `pamid.rigs.simulators.soft_constraints`.

    kind            joint or tendon
    first, second   numbers of y and x; -1: there is no x
    references      (y0, x0)
    coefficients    (5,) of the polynomial, constant first
    rate, stiffness 1/s and 1/s2: of the acceleration at which the error is to vanish
    impedance       (at no error, at a width, the width, midpoint, power)
    """

    kind: str
    first: int
    second: int
    references: Range
    coefficients: Vector
    rate: float
    stiffness: float
    impedance: Vector


def coupled_joints(
    couplings: Sequence[Coupling], tendons: Sequence[MechanismTendon]
) -> frozenset[int]:
    """Joints that couplings move."""
    joints: set[int] = set()
    for c in couplings:
        for end in (c.first, c.second):
            if end >= 0:
                joints.update((end,) if c.kind == "joint" else tendons[end].joints)
    return frozenset(joints)


@dataclass(frozen=True)
class WindingMotor:
    """A motor with a winding: v = R i + K w, torque = K i (MuJoCo, DC Motor Model).

    input            meaning of its command: voltage, pos, vel or ff (torque); none: no command
    resistance, constant   R (Ohm) and K (N m/A or V s/rad)
    current_rate     A/s, largest; 0: no limit
    heating          (thermal resistance K/W, capacity J/K, ambient and reference temperature degC,
                     temperature coefficient of R 1/K); first 0: none
    cogging          (torque N m, periods per rad, phase rad)
    bristles         (stiffness N m/rad, damping N m s/rad, sliding and static level N m, Stribeck
                     velocity rad/s); first 0: none
    controller       (kp, ki, kd): torque per error of the position, its integral, its rate
    integral_limit, voltage_limit  0: none

    The time constant L/R of the current is that of the actuator; 0: the current follows at once.
    """

    input: str
    resistance: float
    constant: float
    current_rate: float
    heating: Vector
    cogging: Vector
    bristles: Vector
    controller: Vector
    integral_limit: float
    voltage_limit: float


@dataclass(frozen=True)
class Mount:
    """A frame on a body, with position and attitude in the body's frame."""

    body: int
    position: Vector = (0.0, 0.0, 0.0)
    quaternion: Vector = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Actuator:
    """force = gain . (1, length, velocity) * a + bias . (1, length, velocity).

    The length is gear times the position of its joint or the length of its tendon. On these acts
    gear times the force.

    kind      motor, position, velocity or general, according to its numbers; dcmotor: the law is
              that of `motor`
    dynamics  of a: none (a is the command), integrator (a' = command) or filter (a' = (command -
              a) / time_constant_s); dcmotor
    joint, tendon  the joint or tendon that it drives; -1: none
    mount, wrench  point of action on a body, with this (force, torque) per unit of the actuator's
              force, in the frame of the mount; it has no length, and its velocity is the power per
              force
    column    column of a recording with its command; "": no command, only passive forces
    states    (name, unit) of its states; without `motor`, that is a alone
    armature, damping, damping_powers  additions to those of its joint or tendon, times gear squared
    adr       place of its command among the simulator's; -1: it has no command, or the file has no
              actuators, and the command is a force or torque that acts on the joint itself
    """

    name: str
    kind: str
    joint: int
    tendon: int
    gear: float
    dynamics: str
    time_constant_s: float
    gain: Vector
    bias: Vector
    column: str
    states: tuple[tuple[str, str], ...] = ()
    command_unit: str = ""
    force_unit: str = "N m"
    command_range: Range | None = None
    force_range: Range | None = None
    activation_range: Range | None = None
    armature: float = 0.0
    damping: float = 0.0
    delay_s: float = 0.0
    adr: int = -1
    damping_powers: Vector = (0.0, 0.0)
    motor: WindingMotor | None = None
    mount: Mount | None = None
    wrench: Vector = ()

    @property
    def is_bare(self) -> bool:
        """True if its command is a force on the joint itself, in a file without actuators."""
        return self.adr < 0 and bool(self.column)


@dataclass(frozen=True)
class MechanismSensor:
    """A reading.

    kind   the simulator's name (jointpos, jointvel, actuatorfrc, tendonpos ...)
    of     number of the joint, tendon or actuator that it reads
    adr    place among the simulator's sensor values; -1: the file has no such sensor, and pamid
           reads the joint itself
    mount, component   frame of a sensor on a frame, and index of this value
    """

    name: str
    kind: str
    of: int
    unit: str
    column: str
    cutoff: float = 0.0
    noise: float = 0.0
    adr: int = -1
    mount: Mount | None = None
    component: int = 0


@dataclass(frozen=True)
class Write:
    """array[row, column] of the simulator's model is factor times the parameter (SI); of an array
    without columns, column is -1."""

    array: str
    row: int
    column: int
    factor: float

    @property
    def place(self) -> tuple[int, ...]:
        return (self.row,) if self.column < 0 else (self.row, self.column)


@dataclass(frozen=True)
class ModelParameter:
    """A number of the file as a parameter.

    element, of   kind and name of its element ("joint", "shoulder")
    attribute     name of the number in the file
    number        index of the element among those of its kind
    """

    parameter: Parameter
    element: str
    of: str
    number: int
    attribute: str
    writes: tuple[Write, ...]

    @property
    def stated(self) -> float:
        """Value in the file, SI."""
        return self.parameter.value * self.parameter.factor

    def value_in(self, model: Any) -> float:
        """Value in a model of the simulator, SI."""
        write = self.writes[0]
        return float(getattr(model, write.array)[write.place]) / write.factor


def write_values(model: Any, mechanism: Mechanism, values: Mapping[str, float]) -> None:
    """Write parameters (SI, by name) into a model of the simulator."""
    for p in mechanism.parameters:
        for write in p.writes:
            getattr(model, write.array)[write.place] = write.factor * values[p.parameter.name]


@dataclass(frozen=True)
class ModelPort:
    """Port for additional physics.

    kind, signals  as in `pamid.model.rig.Port`
    element        joint, actuator or sensor
    number         index among those of its kind
    size           typical magnitudes, SI
    """

    name: str
    kind: str
    unit: str
    signals: tuple[tuple[str, str], ...]
    element: str
    number: int
    size: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class ModelFinding:
    """Part of a file that is not carried over, as a sentence, with the element and its line.

    hinders: it has no form as equations, so its simulator has to step the model.
    """

    text: str
    element: str
    name: str
    line: int
    hinders: bool

    def __str__(self) -> str:
        at = f", line {self.line}" if self.line else ""
        who = f"{self.element} {self.name!r}{at}: " if self.name else f"{self.element}{at}: "
        return f"{who if self.element else ''}{self.text}"


@dataclass(frozen=True)
class Mechanism:
    """A whole model.

    path             the file
    inputs, outputs  column -> SI unit, in the order of actuators and sensors
    noise            standard deviations by column, if the file states any
    sensor_values    number of values of the simulator's sensors, including those that pamid cannot
                     read
    collides         True if the simulator looks for contacts between any two geoms
    """

    path: str
    name: str
    timestep_s: float
    gravity: Vector
    bodies: tuple[Body, ...]
    joints: tuple[MechanismJoint, ...]
    tendons: tuple[MechanismTendon, ...]
    actuators: tuple[Actuator, ...]
    sensors: tuple[MechanismSensor, ...]
    parameters: tuple[ModelParameter, ...]
    ports: tuple[ModelPort, ...]
    findings: tuple[ModelFinding, ...]
    contact_share: float = 0.0  # of the configurations within the joints' ranges
    sensor_values: int = 0
    couplings: tuple[Coupling, ...] = ()
    collides: bool = False

    def lineage(self, body: int) -> list[int]:
        """Bodies from that on the world to this body; none for the world."""
        bodies: list[int] = []
        while body > 0:
            bodies.insert(0, body)
            body = self.bodies[body].parent
        return bodies

    def chain(self, body: int) -> tuple[int, ...]:
        """Joints that move a body."""
        bodies = self.lineage(body)
        return tuple(j for j, joint in enumerate(self.joints) if joint.body in bodies)

    @property
    def commanded(self) -> tuple[int, ...]:
        """Numbers of the actuators that have a command."""
        return tuple(i for i, a in enumerate(self.actuators) if a.column)

    @property
    def hindrances(self) -> tuple[ModelFinding, ...]:
        """Reasons why it cannot be compiled; empty if it can."""
        return tuple(f for f in self.findings if f.hinders)

    @property
    def inputs(self) -> dict[str, str]:
        return {a.column: a.command_unit for a in self.actuators if a.column}

    @property
    def outputs(self) -> dict[str, str]:
        return {s.column: s.unit for s in self.sensors}
