"""Ten inertial parameters of a body, physically consistent for every value.

The mass m, the centre of mass c and the second moments of mass about it, over the mass,

    P = 1 / m integral (r - c) (r - c)' dm,    I = m (tr(P) 1 - P)

form the pseudo-inertia matrix, which is positive definite for every body of positive density.
Log-Cholesky parameters keep it so. The body of the file has P0 = R diag(s) R' about its principal
axes R. It is deformed by an upper triangular matrix L:

    P = R L diag(s) L' R',    L = [e^d1 s12 s13; 0 e^d2 s23; 0 0 e^d3]

For any stretch d, shear s and centre the principal inertias obey the triangle inequalities. Axis 3
is the axis along which the body is longest, so that a small shear tilts a rod. The logarithm of the
mass is the tenth parameter (`mass`), which scales I at the same shape.

References
----------
Rucker, C. and Wensing, P. M. (2022), Smooth parameterization of rigid-body inertia, IEEE Robot.
Autom. Lett. 7(2), 2771-2778, doi:10.1109/LRA.2022.3144517.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pamid.base.arrays import Array
from pamid.engine.symbolic.vocabulary import ZERO, exp, expression
from pamid.model.parameter import Parameter
from pamid.rigs.simulators.mechanism import Body, Mechanism
from pamid.rigs.simulators.spatial import Mat, Vec, constant, rotation, vec

# lower limit of a second moment relative to the largest: a zero moment could not be scaled
THINNEST = 1e-6
# bound: factor of a stretch; radii of gyration of a shift of the centre
LENGTH_FACTOR = 10.0
TOOL_FACTOR = 2.0  # factor of the mass at the end of an arm within one standard deviation
SHAPE = "0: the shape of the model file"
AXES = ("x", "y", "z")
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
STRETCH_NAMES, SHEAR_NAMES = ("stretch1", "stretch2", "stretch3"), ("shear12", "shear13", "shear23")


@dataclass(frozen=True)
class BodyShape:
    """Shape of a body of the file, and the names of the parameters that deform it.

    number    number of the body
    group     name under which all parameters but the mass are released
    radius_m  root mean square distance of its mass from the centre
    """

    number: int
    body: Body

    @property
    def group(self) -> str:
        return f"{self.body.name}_inertia"

    @property
    def centre_names(self) -> tuple[str, ...]:
        return tuple(f"{self.body.name}_centre_{axis}" for axis in AXES)

    @property
    def deformation_names(self) -> tuple[str, ...]:
        """Names of the stretches and shears, which are dimensionless."""
        return tuple(f"{self.body.name}_{word}" for word in (*STRETCH_NAMES, *SHEAR_NAMES))

    @property
    def inertia_names(self) -> tuple[str, ...]:
        """Names of the inertia about the centre along the body's axes: xx, yy, zz, xy, xz, yz."""
        return tuple(f"{self.group}_{AXES[i]}{AXES[k]}" for i, k in PAIRS)

    @property
    def radius_m(self) -> float:
        return math.sqrt(sum(second_moments(self.body)[1]))

    def parameters(self) -> tuple[Parameter, ...]:
        """Centre, stretches and shears.

        Their spreads correspond to second moments known within 100 %, and to a centre known within
        the body's radius.
        """
        radius, far = self.radius_m, LENGTH_FACTOR * self.radius_m
        size = f"the model file; the radius of gyration is {radius:.3g} m"
        parameters = [
            Parameter(name, at, at - far, at + far, "m", radius, source=size)
            for name, at in zip(self.centre_names, self.body.centre, strict=True)
        ]
        for name in self.deformation_names:
            limit = LENGTH_FACTOR if "_shear" in name else math.log(LENGTH_FACTOR)
            parameters.append(
                Parameter(name, 0.0, -limit, limit, spread=0.5, inner=True, source=SHAPE)
            )
        return tuple(parameters)

    def as_tool(self, parameters: Sequence[Parameter]) -> tuple[Parameter, ...]:
        """Add the shape to a model's parameters, with a mass known within a factor of two."""
        unladen = "the model file, where a tool or a payload may be missing"
        return (
            *(
                replace(p, spread=TOOL_FACTOR, source=unladen)
                if p.name == f"{self.body.name}_mass"
                else p
                for p in parameters
            ),
            *self.parameters(),
        )

    def second_moment(self, p: Any) -> Mat:
        """P about the centre along the body's axes, m2; p: parameters by name, numbers or
        symbols."""
        axes, moments = second_moments(self.body)
        d1, d2, d3, s12, s13, s23 = (expression(getattr(p, n)) for n in self.deformation_names)
        deformation = [[exp(d1), s12, s13], [ZERO, exp(d2), s23], [ZERO, ZERO, exp(d3)]]
        turned = constant(axes) @ np.array(deformation)
        return np.asarray((turned * moments) @ turned.T)

    def centre(self, p: Any) -> Vec:
        """Centre of mass in the body's frame, m; p as in `second_moment`."""
        return vec([getattr(p, name) for name in self.centre_names])

    def inertia(self, p: Any, mass: Any) -> tuple[Any, ...]:
        """Inertia about the centre along the body's axes in the order of `inertia_names`, kg m2."""
        about = inertia_per_mass(self.second_moment(p))
        return tuple(mass * about[i, k] for i, k in PAIRS)

    def deformed(self, values: Mapping[str, float], mass: float) -> Body:
        """Return the body with these parameter values, by name, SI."""
        p, full = SimpleNamespace(**values), np.zeros((3, 3))
        for (i, k), value in zip(PAIRS, self.inertia(p, mass), strict=True):
            full[i, k] = full[k, i] = float(value)
        centre = tuple(float(v) for v in self.centre(p))
        return with_full_inertia(replace(self.body, mass_kg=mass, centre=centre), full)


def shapes_of(mechanism: Mechanism) -> tuple[BodyShape, ...]:
    """Shapes of all bodies that a joint moves and that have an inertia."""
    moving = {joint.body for joint in mechanism.joints}
    shapes = []
    for number, body in enumerate(mechanism.bodies):
        if body.parent in moving:
            moving.add(number)
        if number in moving and body.mass_kg > 0.0 and max(body.inertia) > 0.0:
            shapes.append(BodyShape(number, body))
    return tuple(shapes)


def tool_body(mechanism: Mechanism, shapes: Sequence[BodyShape]) -> BodyShape | None:
    """Heaviest body behind the last joint of an arm; None if there is no arm.

    A tool or a payload is mounted there, and no model file states its mass, centre and shape. An
    arm is one chain of joints. With fewer than three, the body turns about too few axes.
    """
    jointed = {joint.body for joint in mechanism.joints}
    if len(jointed) < len(AXES):
        return None
    last = [shape for shape in shapes if jointed <= {*mechanism.lineage(shape.number)}]
    return max(last, key=lambda shape: shape.body.mass_kg, default=None)


def second_moments(body: Body) -> tuple[Array, list[float]]:
    """Principal axes as columns (3, 3), and the second moments of mass along them.

    The moments are divided by the mass (m2), the largest last.
    """
    inertia = np.array(body.inertia)
    moments = (0.5 * inertia.sum() - inertia) / body.mass_kg
    order = np.argsort(moments, kind="stable")
    axes = rotation(body.inertia_quaternion)[:, order]
    least = THINNEST * float(moments.max())
    return axes, [max(float(moments[k]), least) for k in order]


def inertia_per_mass(second: Mat) -> Mat:
    """tr(P) 1 - P"""
    trace = second[0, 0] + second[1, 1] + second[2, 2]
    return np.array([[(trace if i == k else ZERO) - second[i, k] for k in range(3)]
                     for i in range(3)])  # fmt: skip


def full_inertia(body: Body) -> Array:
    """Inertia about the centre along the body's axes (3, 3), kg m2."""
    axes = rotation(body.inertia_quaternion)
    return axes @ np.diag(body.inertia) @ axes.T


def with_full_inertia(body: Body, full: Array) -> Body:
    """Return the body with this inertia about its centre, along the body's axes.

    It is stored as principal inertias, largest first.
    """
    principal, axes = np.linalg.eigh(full)
    axes = axes[:, ::-1] * [1.0, 1.0, np.linalg.det(axes[:, ::-1])]
    quaternion = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    return replace(
        body,
        inertia=tuple(map(float, principal[::-1])),
        inertia_quaternion=tuple(map(float, quaternion)),
    )
