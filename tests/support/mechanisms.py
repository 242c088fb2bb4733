"""MuJoCo models for the tests, from one joint to seven, and MuJoCo itself at given states as the
judge of what pamid makes of them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pamid.base.arrays import Array
from pamid.engine.symbolic.expression import Expr, plain, symbol, walk
from pamid.engine.symbolic.operators import OPERATORS
from pamid.rigs.simulators.compiled_rig import CompiledMechanism
from pamid.rigs.simulators.mechanism import write_values
from pamid.rigs.simulators.mujoco_file import open_mujoco
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism

ONE = """<mujoco model="one">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="RK4"/>
  <worldbody>
    <body name="arm">
      <joint name="shoulder" axis="0 1 0" damping="0.08" armature="0.004"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.8"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="shoulder" gear="2" ctrlrange="-1 1"/></actuator>
</mujoco>
"""

TWO = """<mujoco model="two">
  <!-- a small arm, seen from the side -->
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="RK4"/>
  <default>
    <joint damping="0.15" armature="0.01"/>
    <geom contype="0" conaffinity="0"/>
  </default>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03" mass="1.2"/>
      <body name="forearm" pos="0 0 -0.4">
        <!-- the one that squeaks -->
        <joint name="elbow"   axis="0 1 0" damping='0.08'/>
        <inertial pos="0 0 -0.15" mass="0.7" diaginertia="0.006 0.006 0.0003"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m1" joint="shoulder" gear="4" ctrlrange="-1 1"/>
    <motor name="m2" joint="elbow" gear="1.5" ctrlrange="-1 1"/>
  </actuator>
  <sensor>
    <jointpos name="shoulder_angle" joint="shoulder"/>
    <jointpos name="elbow_angle" joint="elbow"/>
  </sensor>
</mujoco>
"""

# everything that is compiled: a slide, two joints at one body, a branch, oblique axes, welded
# bodies, a tendon with spring and damper, springs, every plain actuator, ranges, unnamed elements
TREE = """<mujoco model="tree">
  <compiler angle="radian"/>
  <option gravity="0.3 -0.2 -9.7"><flag contact="disable"/></option>
  <worldbody>
    <body name="cart" pos="0.1 0 0.2" quat="0.9 0.1 -0.2 0.3">
      <joint name="rail" type="slide" axis="1 0.2 0" damping="3" stiffness="40" springref="0.1"/>
      <geom size="0.1" mass="2"/>
      <body name="hip-1" pos="0 0.1 0">
        <joint name="yaw" axis="0 0 1" pos="0.05 0 0" armature="0.02" damping="0.2" ref="0.2"/>
        <joint name="tilt" axis="0.3 1 0.2" damping="0.1" actuatorfrcrange="-0.4 0.4"
               actuatorfrclimited="true"/>
        <inertial pos="0.05 0.02 -0.2" mass="1.1" fullinertia="0.02 0.03 0.025 0.001 -0.002 0.003"/>
        <body name="plate" pos="0 0 -0.3" quat="0.7 0.1 0.7 0">
          <geom type="box" size="0.1 0.05 0.02" mass="0.6"/>
        </body>
        <body name="shin" pos="0 0 -0.4">
          <joint name="knee" axis="0 1 0" damping="0.05" stiffness="2" springref="-0.3"/>
          <geom type="capsule" fromto="0 0 0 0.1 0 -0.3" size="0.03" mass="0.5"/>
        </body>
      </body>
      <body name="tail" pos="-0.2 0 0" euler="0.3 0.2 0.1">
        <joint name="wag" axis="0 0 -1" damping="0.03" armature="0.005"/>
        <geom type="capsule" fromto="0 0 0 -0.3 0 0" size="0.02" mass="0.3"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="cable" stiffness="6" damping="0.4" springlength="0.05 0.1">
      <joint joint="yaw" coef="0.5"/><joint joint="wag" coef="-1.2"/>
    </fixed>
  </tendon>
  <actuator>
    <motor name="push" joint="rail" gear="-30" ctrlrange="-0.5 0.5"/>
    <position name="turn" joint="yaw" kp="8" kv="0.6" ctrlrange="-1 1" forcerange="-3 3"/>
    <velocity name="spin" joint="wag" kv="0.3" gear="2"/>
    <general name="slow" joint="knee" dyntype="filter" dynprm="0.05" gaintype="affine"
             gainprm="2 0.3 -0.1" biastype="affine" biasprm="0.2 -1 -0.05"/>
    <intvelocity name="step" joint="yaw" kp="3" actrange="-0.5 0.5"/>
    <motor name="pull" tendon="cable" gear="3"/>
    <motor name="geared" joint="knee" gear="2" armature="0.003" damping="0.02"/>
    <motor joint="tilt" gear="5"/>
  </actuator>
  <sensor>
    <jointpos joint="yaw"/><jointvel joint="rail"/><tendonpos tendon="cable"/>
    <tendonvel tendon="cable"/><actuatorfrc actuator="turn"/><actuatorfrc actuator="slow"/>
    <actuatorpos actuator="spin"/><actuatorvel actuator="push"/>
    <jointactuatorfrc name="knee torque" joint="knee"/>
    <jointpos name="clipped" joint="wag" cutoff="0.4"/>
  </sensor>
</mujoco>
""".replace('<joint axis="0.3 1 0.2"', '<joint name="joint_unnamed_stand_in" axis="0.3 1 0.2"')

# motors with windings, springs and dampers that are not linear, a spring that yields, gravity
# compensation, and couplings of joints and tendons
TERMS = """<mujoco model="terms">
  <compiler angle="radian"/>
  <option timestep="0.001" gravity="0.4 0.3 -9.5"><flag contact="disable"/></option>
  <worldbody>
    <body name="upper" gravcomp="0.7">
      <joint name="shoulder" axis="0 1 0" damping="0.1 0.02 0.03" stiffness="1 0.2 0.3"
             springyield="0.2" ref="0.1" springref="0.2"/>
      <geom size="0.1" mass="1" pos="0.2 0 0"/>
      <body name="lower" pos="0.4 0 0" gravcomp="1.2">
        <joint name="elbow" axis="0.2 1 0" damping="0 0.2 0" frictionloss="0.3"
               actuatorgravcomp="true" actuatorfrcrange="-2 2" actuatorfrclimited="true"/>
        <joint name="rail" type="slide" axis="1 0 0" stiffness="3 0 20"/>
        <geom size="0.1" mass="1" pos="0.2 0 0"/>
      </body>
    </body>
    <body name="left" pos="1 0 0">
      <joint name="driver" axis="0 1 0"/><geom size="0.1" mass="0.3" pos="0.1 0 0.1"/>
    </body>
    <body name="right" pos="1 1 0">
      <joint name="follower" axis="0 0 1" frictionloss="0.1"/>
      <geom size="0.1" mass="0.2" pos="0.1 0 0.1"/>
    </body>
  </worldbody>
  <tendon>
    <fixed name="cable" stiffness="3 0.4 0.5" damping="0.1 0.2 0.3" springlength="0.1 0.2">
      <joint joint="shoulder" coef="0.5"/><joint joint="elbow" coef="-2"/>
    </fixed>
    <fixed name="cross" range="-1 1" limited="true">
      <joint joint="driver" coef="0.5"/><joint joint="follower" coef="-2"/>
    </fixed>
  </tendon>
  <equality>
    <joint name="mimic" joint1="follower" joint2="driver" polycoef="0.1 0.5 0.2 0.3 0.1"
           solimp="0.3 0.8 0.5 0.3 3" solref="0.05 0.7"/>
    <tendon tendon1="cross" polycoef="0.2 0 0 0 0" solref="-100 -5"/>
    <joint joint1="rail" joint2="elbow" polycoef="0 0.1 0 0 0"/>
  </equality>
  <actuator>
    <dcmotor name="rub" joint="elbow" input="none" resistance="1" motorconst="0" gear="3"
             lugre="30 0.1 0.01 0.02 0.05" cogging="0.02 7 0.3"/>
    <dcmotor name="servo" joint="shoulder" input="pos" gear="3" resistance="2"
             motorconst="0.1 0.12" inductance="0.01 0" thermal="5 20 0 0.004 25 22"
             lugre="30 0.1 0.01 0.02 0.05" cogging="0.02 7 0.3" damping="0.01 0.002 0.003"
             armature="0.0002" controller="3 0.5 0.2 0 1.5 24" saturation="0.5 0 100"/>
    <dcmotor name="speed" joint="driver" input="vel" resistance="3" motorconst="0.2"
             controller="1 0 0.4 0 0 5" thermal="5 20 0 0.004 25 22"/>
    <dcmotor name="volts" joint="rail" nominal="24 0.5 300" gear="20"/>
    <dcmotor name="torque" tendon="cable" nominal="24 0.5 300" gear="20" input="ff"
             inductance="0 0.003" damping="0.001 0.002 0.003"/>
  </actuator>
  <sensor>
    <actuatorfrc actuator="rub"/><actuatorfrc actuator="servo"/><actuatorfrc actuator="speed"/>
    <actuatorfrc actuator="torque"/><jointactuatorfrc joint="elbow"/><jointpos joint="rail"/>
  </sensor>
</mujoco>
"""

# a floating base with thrusters at sites, a link on it, and an object that nothing drives
DRONE = """<mujoco model="drone">
  <compiler angle="radian"/>
  <default><joint damping="0.05" armature="0.01"/></default>
  <option timestep="0.001" integrator="RK4"><flag contact="disable"/></option>
  <worldbody>
    <body name="drone" pos="0.1 0.2 1">
      <freejoint name="fly"/>
      <inertial pos="0.02 0 0.01" mass="1.2" fullinertia="0.02 0.03 0.025 0.001 -0.002 0.003"/>
      <site name="left" pos="0.1 0.1 0" quat="0.9 0.1 0 0"/>
      <site name="right" pos="-0.1 -0.1 0"/>
      <body name="camera" pos="0.2 0 0" quat="0.8 0 0.2 0.1">
        <joint name="gimbal" axis="0 1 0.2"/>
        <geom size="0.03" mass="0.2" pos="0.1 0 0"/>
        <site name="lens" pos="0.1 0 0.02" quat="0.9 0 0.1 0.3"/>
      </body>
    </body>
    <body name="box" pos="1 0 0"><freejoint name="loose"/><geom size="0.1" mass="1"/></body>
  </worldbody>
  <actuator>
    <motor name="thrust_left" site="left" gear="0 0 1 0 0 0.1"/>
    <general name="thrust_right" site="right" gear="0 0 1 0 0 -0.1" biastype="affine"
             biasprm="0 0 -0.1"/>
    <position name="turn" joint="gimbal" kp="0.5"/>
  </actuator>
  <sensor>
    <framepos name="place" objtype="xbody" objname="drone"/>
    <framequat name="attitude" objtype="xbody" objname="drone"/>
    <gyro name="gyro" site="lens"/><velocimeter name="speed" site="lens"/>
    <framepos name="centre" objtype="body" objname="camera"/>
    <framequat name="view" objtype="site" objname="lens"/>
    <framelinvel name="moving" objtype="site" objname="lens"/>
    <frameangvel name="turning" objtype="body" objname="camera"/>
    <jointpos name="gimbal_angle" joint="gimbal"/>
  </sensor>
  <keyframe><key qpos="0 0 1 1 0 0 0 0 1 0 0 1 0 0 0"/></keyframe>
</mujoco>
"""


def _seven() -> str:
    places = (
        "0 0 0.33",
        "0 0 0",
        "0 -0.316 0",
        "0.0825 0 0",
        "-0.0825 0.384 0",
        "0 0 0",
        "0.088 0 0",
    )
    turns = (0, -1, 1, 1, -1, 1, 1)
    masses = (3.2, 3.1, 3.2, 2.5, 1.2, 1.5, 0.7)
    centres = ("0.003 0.05 -0.02", "-0.003 -0.07 0.03", "0.027 0.04 -0.07", "-0.05 0.1 0.03",
               "-0.01 0.04 -0.04", "0.06 -0.015 -0.01", "0.01 0.004 0.06")  # fmt: skip
    bodies, ends = [], []
    for i in range(7):
        turn = f' quat="0.70710678 {0.70710678 * turns[i]} 0 0"' if turns[i] else ""
        inertia = " ".join(f"{0.01 * masses[i] * s:.5g}" for s in (1.0, 0.9, 0.7))
        bodies.append(
            f'<body name="link{i + 1}" pos="{places[i]}"{turn}>'
            f'<joint name="j{i + 1}" axis="0 0 1"/><inertial pos="{centres[i]}" '
            f'mass="{masses[i]}" quat="0.9 0.1 0.2 0.05" '
            f'diaginertia="{inertia}"/>'
        )
        ends.append("</body>")
    motors = "".join(f'<motor name="m{i}" joint="j{i}" gear="10"/>' for i in range(1, 8))
    return (
        '<mujoco model="seven"><compiler angle="radian"/><option timestep="0.002"/>'
        '<default><joint damping="0.5" armature="0.02" frictionloss="0.1"/></default>'
        f"<worldbody>{''.join(bodies + ends)}</worldbody><actuator>{motors}</actuator></mujoco>"
    )


SEVEN = _seven()


def needs_mujoco() -> Any:
    """MuJoCo's package, or a skip that says why."""
    return pytest.importorskip("mujoco", reason="the extra pamid[mujoco] is not installed")


def written(folder: Path, text: str, name: str = "model.xml") -> Path:
    """File with the text of a model."""
    file = folder / name
    file.write_text(text)
    return file


def rig_from(text: str, folder: Path) -> CompiledMechanism:
    """The compiled rig of a model's text."""
    return CompiledMechanism(read_mechanism(written(folder, text)))


class _Names:
    def __init__(self, space: str) -> None:
        self._space = space

    def __getattr__(self, name: str) -> Any:
        return symbol(self._space, name)


def numbers(roots: Sequence[Expr], values: Mapping[tuple[str, str], float]) -> Array:
    """The values of expressions where their symbols have these."""
    found: dict[Expr, float] = {}
    for node in walk(roots):
        if node.op == "const":
            found[node] = node.value
        elif node.op == "symbol":
            found[node] = values[node.value]
        elif node.op == "where":
            taken = node.args[1] if found[node.args[0]] else node.args[2]
            found[node] = found[taken]
        else:
            found[node] = float(OPERATORS[node.op].evaluate(*(found[a] for a in node.args)))
    return np.array([found[root] for root in roots])


class AtStates:
    """A compiled rig's rates and readings as numbers."""

    def __init__(self, rig: CompiledMechanism) -> None:
        self.rig = rig
        args = (_Names("state"), _Names("input"), _Names("parameter"))
        rates, readings = rig.rates(*args, _through), rig.measure(*args, _through)
        self.names = (list(rates), list(readings))
        self.roots = plain([*rates.values(), *readings.values()])

    def __call__(
        self, x: dict[str, float], u: dict[str, float], p: dict[str, float]
    ) -> tuple[dict[str, float], dict[str, float]]:
        """Rates and readings by name."""
        values = {("state", k): v for k, v in x.items()} | {("input", k): v for k, v in u.items()}
        found = numbers(self.roots, values | {("parameter", k): v for k, v in p.items()}).tolist()
        first, second = self.names
        return dict(zip(first, found, strict=False)), dict(
            zip(second, found[len(first) :], strict=True)
        )


def _through(name: str, value: Any, **signals: Any) -> Any:
    return value


def parameters(rig: CompiledMechanism) -> dict[str, float]:
    """The file's values, SI."""
    return {p.name: p.value * p.factor for p in rig.parameters}


def mujoco_at(
    rig: CompiledMechanism,
    x: dict[str, float],
    u: dict[str, float],
    p: Mapping[str, float] | None = None,
) -> tuple[dict[str, float], dict[str, float]]:
    """MuJoCo's own accelerations, activation rates and readings in the same state, at these values
    of the parameters (default: those of the file)."""
    mujoco, m = needs_mujoco(), rig.mechanism
    model = open_mujoco(m.path).model
    if p is not None:
        write_values(model, m, p)
        mujoco.mj_setConst(model, mujoco.MjData(model))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    model.opt.tolerance, model.opt.iterations = 0.0, 200
    model.actuator_actearly[:] = 0  # a matter of the time step
    data = mujoco.MjData(model)
    for joint in m.joints:
        data.qpos[joint.qpos] = x[joint.name]
        data.qvel[joint.dof] = x[f"{joint.name}_velocity"]
    for j, joint in enumerate(m.joints):
        if joint.spring_state:
            data.plastic[model.jnt_plasticadr[j]] = x[joint.spring_state]
    states = [name for a in m.actuators for name, _ in a.states]  # in the order of act
    data.act[:] = [x[name] for name in states]
    for i in m.commanded:
        data.ctrl[m.actuators[i].adr] = u[m.actuators[i].column]
    mujoco.mj_forward(model, data)
    rates = {f"{j.name}_velocity": float(data.qacc[j.dof]) for j in m.joints}
    rates |= {name: float(data.act_dot[i]) for i, name in enumerate(states)}
    return rates, {s.column: float(data.sensordata[s.adr]) for s in m.sensors if s.adr >= 0}
