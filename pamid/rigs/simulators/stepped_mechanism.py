"""A mechanism as a rig that MuJoCo steps, for parts without a form as equations.

Such parts are contacts, closed loops and tendons over sites. The inputs are the commands, through
their ports, and at every joint the force that effects add (qfrc_applied). The model states the
force on the joint in part (`compiled_rig.py`). Effects get this part as their value,
and return a difference. Parameters are written into copies of the model. A step begins with a cold
start of the solver, so that the same arguments lead to the same states.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.engine.simulator import LibraryStep
from pamid.engine.simulator_warnings import add_warnings
from pamid.engine.symbolic.vocabulary import Number
from pamid.model.effect import State
from pamid.model.step_rig import StepRig
from pamid.rigs.simulators.body_inertia import BodyShape
from pamid.rigs.simulators.compiled_rig import CompiledMechanism, MechanismEquations
from pamid.rigs.simulators.mechanism import Mechanism, write_values
from pamid.rigs.simulators.mujoco_file import open_mujoco
from pamid.rigs.simulators.mujoco_findings import NOT_ENFORCED

MOST_MODELS = 128  # stored copies of the model, each with different parameters
# tolerance of the constraint solver in place of the file's, whose residual would drown differences
SOLVER_TOLERANCE = 1e-13
#: mjtWarning -> text
WARNINGS = {
    "mjWARN_INERTIA": "a nearly singular inertia matrix",
    "mjWARN_CONTACTFULL": "contacts dropped",
    "mjWARN_CNSTRFULL": "all forces of contacts and limits dropped",
    "mjWARN_BADQPOS": "a position that is not finite",
    "mjWARN_BADQVEL": "a velocity that is not finite",
    "mjWARN_BADQACC": "an acceleration that is not finite",
    "mjWARN_BADCTRL": "a command that is not finite",
}
_MEMORY = 'The memory for contacts is full: enlarge <size memory="..."/> in the model.'
WARNING_CURES = {words: _MEMORY for words in WARNINGS.values() if "dropped" in words}


class SteppedMechanism(StepRig, CompiledMechanism):
    """Rig made of a `Mechanism`, stepped by MuJoCo."""

    name = "stepped-mechanism"

    def __init__(self, mechanism: Mechanism) -> None:
        CompiledMechanism.__init__(self, mechanism)
        for joint in mechanism.joints:
            if joint.kind not in ("hinge", "slide"):
                line = f", line {joint.line}" if joint.line else ""
                raise FileError(
                    f"{mechanism.path}: joint {joint.name!r}{line} is a {joint.kind} joint, whose "
                    "quaternion pamid cannot carry as states.",
                    "Write it as hinges and slides, or hold the body.",
                    code="model",
                )
        untyped: Any = self
        port_names = {p.name for p in mechanism.ports if p.kind != "transmission"}
        untyped.ports = {name: port for name, port in self.ports.items() if name in port_names}
        untyped.states = (*self.states, *self._further)
        untyped.remarks = (
            f"stepped by MuJoCo, its own step {mechanism.timestep_s:g} s: "
            + "; ".join(map(str, mechanism.hindrances)),
            "left out: effects between joint and link (backlash, a soft shaft), which need the "
            "model as equations",
            *(
                str(f)
                for f in mechanism.findings
                if not f.hinders and not f.text.endswith(NOT_ENFORCED)
            ),
        )

    @cached_property
    def _further(self) -> tuple[State, ...]:
        """Activations without a place in the description: of muscles and the like."""
        actuators, names = self.mechanism.actuators, self._stepper.actuator_names
        described = {i for i, a in enumerate(actuators) if a.states}
        model = self._stepper.model
        return tuple(
            State(f"{names[i]}_activation{'' if not k else k + 1}")
            for i in range(model.nactuator)
            if i not in described
            for k in range(max(0, int(model.actuator_actnum[i])))
        )

    @cached_property
    def _stepper(self) -> _Stepper:
        return _Stepper(self.mechanism, self.shapes, [p.name for p in self.parameters])

    # ---- what goes in, and what comes of it ------------------------------------------------------

    def drive(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        equations, m = MechanismEquations(self, x, u, p, port), self.mechanism
        dynamic = [i for i in m.commanded if not m.actuators[i].is_bare]
        into: dict[str, Number] = {
            f"{m.actuators[i].name}_command": equations.command(i) for i in dynamic
        }
        # actuators with a law in the description; those that pamid puts in the place of actuators,
        # where the file has none, go in from outside
        lawless = {f.name for f in m.hindrances if f.element == "actuator"}
        known = [
            i
            for i, a in enumerate(m.actuators)
            if (a.joint >= 0 or a.tendon >= 0)
            and (a.is_bare or self._stepper.actuator_names[i] not in lawless)
        ]
        inside = equations.known_forces(i for i in known if not m.actuators[i].is_bare)
        for j, force in enumerate(equations.known_forces(known)):
            into[f"{m.joints[j].name}_force"] = equations.at_joint(j, force) - inside[j]
        return into

    def steps(
        self, x: Array, f: Array, p: Array, h: float, into: tuple[str, ...]
    ) -> tuple[Array, Array]:
        return self._stepper.steps(x, f, p, h), np.empty((len(x), 0))

    def in_c(
        self, p: Array, h: float, into: tuple[str, ...]
    ) -> AbstractContextManager[LibraryStep | None]:
        return self._stepper.in_c(p, h)


class _Stepper:
    """MuJoCo with parameters written into its models, and states in pamid's order."""

    def __init__(
        self, mechanism: Mechanism, shapes: Sequence[BodyShape], names: Sequence[str]
    ) -> None:
        # many copies of the model are stored, and meshes may take megabytes in each
        file = open_mujoco(mechanism.path, visual=False)
        self.mujoco, self.model, self.m = file.mujoco, file.model, mechanism
        model = self.model
        model.opt.tolerance = min(model.opt.tolerance, SOLVER_TOLERANCE)
        model.actuator_delay[:] = 0.0  # delays are pamid's
        # an unstable state would silently become that of the reference
        model.opt.disableflags |= int(self.mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        # readings are worked out of the states
        model.opt.disableflags |= int(self.mujoco.mjtDisableBit.mjDSBL_SENSOR)
        if model.ntree == 1:  # a single island: looking for others takes a tenth of a step
            model.opt.disableflags |= int(self.mujoco.mjtDisableBit.mjDSBL_ISLAND)
        self.actuator_names = [file.name("actuator", i) for i in range(model.nactuator)]
        self.data = self.mujoco.MjData(model)
        kinds = self.mujoco.mjtState
        self.full = kinds.mjSTATE_FULLPHYSICS
        self.size = self.mujoco.mj_stateSize(model, self.full)
        self.model_of_values: dict[bytes, Any] = {}
        described = [i for i, a in enumerate(mechanism.actuators) if a.states]
        further = [i for i in range(model.nactuator) if i not in described]
        acts = [
            [model.actuator_actadr[i] + k for i in of for k in range(model.actuator_actnum[i])]
            for of in (described, further)
        ]
        # relaxed positions of yielding springs; states stand in the order of their bits
        before = int(self.full) & (int(kinds.mjSTATE_PLASTIC) - 1)
        first = self.mujoco.mj_stateSize(model, before)
        plastic = [
            first + model.jnt_plasticadr[j]
            for j, joint in enumerate(mechanism.joints)
            if joint.spring_state
        ]
        qpos, dof = [j.qpos for j in mechanism.joints], [j.dof for j in mechanism.joints]
        # time comes first
        self.places = np.array(
            [
                *(1 + q for q in qpos),
                *(1 + model.nq + d for d in dof),
                *(1 + model.nq + model.nv + act for act in acts[0]),
                *plastic,
                *(1 + model.nq + model.nv + act for act in acts[1]),
            ]
        )
        self.forces = np.array([*range(model.nu), *(model.nu + d for d in dof)])
        self.start = np.zeros(self.size)
        self.mujoco.mj_getState(model, self.data, self.start, self.full)
        self.shapes, self.names = shapes, names
        for shape in shapes:  # MuJoCo leaves out the centre of a body whose frame is at the centre
            model.body_sameframe[shape.number] = self.mujoco.mjtSameFrame.mjSAMEFRAME_NONE

    def steps(self, x: Array, f: Array, p: Array, h: float) -> Array:
        """States (n, states) h seconds after x under f, with parameters p (all of n rows)."""
        count, after = max(1, int(np.ceil(h / self.m.timestep_s - 1e-9))), np.empty_like(x)
        mujoco, data, full = self.mujoco, self.data, self.full
        state, control = self.start.copy(), np.zeros(self.model.nu + self.model.nv)
        mujoco.mj_resetData(self.model, data)
        for k, row in enumerate(p):
            model = self.with_values(row, h / count)
            state[self.places], control[self.forces] = x[k], f[k]
            mujoco.mj_setState(model, data, state, full)
            data.ctrl[:], data.qfrc_applied[:] = np.split(control, [self.model.nu])
            data.qacc_warmstart[:] = 0.0
            mujoco.mj_step(model, data, count)
            mujoco.mj_getState(model, data, state, full)
            after[k], state = state[self.places], self.start.copy()
        self._add_warnings(count * len(x))
        return after

    def _add_warnings(self, steps: int) -> None:
        """Count MuJoCo's warnings since the reset of its data, over this number of steps."""
        warned = {
            words: int(self.data.warning[int(getattr(self.mujoco.mjtWarning, name))].number)
            for name, words in WARNINGS.items()
        }
        add_warnings("MuJoCo", steps, warned, WARNING_CURES)

    @contextmanager
    def in_c(self, p: Array, h: float) -> Iterator[LibraryStep | None]:
        """MuJoCo's mj_step on an mjData, without Python in between.

        For a model with a joint and a contact, the calls would take nine tenths of the time. None
        for a model with further memory (plug-ins, histories, sleeping), and without the library.
        """
        if not (self.mj_step and self.whole and len(p) <= MOST_MODELS):
            yield None
            return
        count = max(1, int(np.ceil(h / self.m.timestep_s - 1e-9)))
        models = [self.with_values(row, h / count) for row in p]
        self.mujoco.mj_resetData(self.model, self.data)
        with self._without_clock():
            yield LibraryStep(
                self.mj_step,
                self.data._address,
                np.array([m._address for m in models], np.int64),
                count,
                *self.addresses,
                np.zeros(0, np.int64),
                0,
            )
        self._add_warnings(round(self.data.time * count / h))

    @cached_property
    def library(self) -> ctypes.CDLL | None:
        """MuJoCo's library, None if it is not found."""
        folder = Path(str(self.mujoco.__file__)).parent
        for name in sorted((*folder.glob("*mujoco*.so*"), *folder.glob("*mujoco*.d*l*"))):
            library = ctypes.CDLL(str(name))
            if hasattr(library, "mj_step"):
                return library
        return None

    @cached_property
    def mj_step(self) -> int:
        """Address of the function, 0 without the library."""
        if self.library is None:
            return 0
        return ctypes.cast(self.library.mj_step, ctypes.c_void_p).value or 0

    @contextmanager
    def _without_clock(self) -> Iterator[None]:
        """MuJoCo without the clock that its Python package sets.

        A step reads this clock thirty times for unused timers, which takes a seventh of the step.
        """
        try:
            clock = ctypes.c_void_p.in_dll(self.library, "mjcb_time")  # type: ignore[arg-type]
        except (TypeError, ValueError):  # no such library, or it has no such variable
            yield
            return
        before, clock.value = clock.value, None
        try:
            yield
        finally:
            clock.value = before

    @cached_property
    def whole(self) -> bool:
        """True if a state contains everything that a step begins with."""
        model, asleep = self.model, self.mujoco.mjtEnableBit.mjENBL_SLEEP
        rest = self.size - 1 - model.nq - model.nv - model.na
        return rest == 0 and not int(model.opt.enableflags) & int(asleep)

    @cached_property
    def addresses(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Addresses of states and forces in mjData, and of values reset before every exchange."""
        data = self.data

        def of(*names: str) -> NDArray[np.int64]:
            arrays = [getattr(data, name) for name in names]
            return np.concatenate([a.ctypes.data + 8 * np.arange(a.size) for a in arrays])

        state = of("qpos", "qvel", "act")[self.places - 1]
        return state, of("ctrl", "qfrc_applied")[self.forces], of("qacc_warmstart")

    def with_values(self, row: Array, timestep_s: float) -> Any:
        """Model with these parameters."""
        key = row.tobytes()
        # put back as the last: the first is written anew
        model = self.model_of_values.pop(key, None)
        if model is None:
            if len(self.model_of_values) < MOST_MODELS:
                model = self.mujoco.MjModel.__copy__(self.model)
            else:
                model = self.model_of_values.pop(next(iter(self.model_of_values)))
            values = dict(zip(self.names, row.tolist(), strict=True))
            write_values(model, self.m, values)
            model.actuator_delay[:] = 0.0  # delays are pamid's
            for shape in self.shapes:
                i = shape.number
                body = shape.deformed(values, float(model.body_mass[i]))
                model.body_ipos[i], model.body_iquat[i] = body.centre, body.inertia_quaternion
                model.body_inertia[i] = body.inertia
            self.mujoco.mj_setConst(model, self.data)
        self.model_of_values[key] = model
        model.opt.timestep = timestep_s
        return model
