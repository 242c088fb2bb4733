"""An FMU as a rig: its inputs and outputs are ports, its parameters are fitted.

A table next to the file, `drive.fmu.toml`, declares inputs that are forces or torques, with the
outputs for the position and the velocity there (`pamid.rigs.simulators.fmu_choices`). Effects of
mechanics then act at the port. Without the table there are command ports and reading ports. A rig
file states the same with

    class Drive(FmuRig):
        path = "drive.fmu"
        motion = {"torque_n_m": ("angle_rad", "speed_rad_per_s")}

The FMU's binary is executed. In model exchange pamid sees the states and integrates their rates. An
FMU for co-simulation is a `Carrier`.
"""

from __future__ import annotations

import os
import sys
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError, nearest
from pamid.base.units import quotient
from pamid.engine.stepped import FarRunner
from pamid.engine.symbolic.vocabulary import Number
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port
from pamid.model.step_rig import StepRig
from pamid.rigs.simulators.fmu_choices import choices_path
from pamid.rigs.simulators.fmu_file import FmuFile, FmuVariable, read_fmu
from pamid.rigs.simulators.fmu_process import FmuProcess
from pamid.rigs.simulators.mujoco_parameters import stated_parameter

MOST_FREE = 20  # of more parameters only those in `free` are fitted
FORCES = ("N", "N m")


class FmuRig(StepRig):
    """A rig made of an FMU."""

    name = "fmu"
    carries = True
    # relative to the rig file, else to the working folder
    path: ClassVar[str] = ""
    # input that is a force or torque -> outputs: position and velocity there
    motion: ClassVar[dict[str, tuple[str, str]]] = {}
    # parameters to fit, if not all of them
    free: ClassVar[tuple[str, ...]] = ()

    def __init__(self, file: FmuFile | None = None) -> None:
        untyped: Any = self  # these tables usually are class attributes
        if file is None:  # a path in a rig file is relative to the folder of that file
            home = getattr(sys.modules.get(type(self).__module__), "__file__", None)
            file = read_fmu(Path(os.path.dirname(home) if home else "") / self.path)
        self.file = f = file
        untyped.name = f.name if type(self) is FmuRig else type(self).name
        untyped.carries = not f.seen
        untyped.motion, untyped.free = self.motion or f.motion, self.free or f.free
        untyped.inputs = {v.name: v.si for v in f.inputs}
        untyped.outputs = {v.name: v.si for v in f.outputs}
        if f.seen:
            untyped.states = tuple(
                State(v.name, v.si, v.start * v.scale[0] + v.scale[1]) for v in f.states
            )
            untyped.scales = {
                v.name: size * v.scale[0] for v, size in zip(f.states, f.nominals, strict=True)
            }
        shown = {s.name for s in self.states}
        untyped.readings = {name: si for name, si in self.outputs.items() if name not in shown}
        self._check_names()
        untyped.parameters = tuple(map(self._parameter, f.parameters))
        choices_file = choices_path(Path(f.path)).name
        undeclared = [
            f"{name} [{si}] may be a force at a moving part: for friction, springs "
            f"and drag to act there, write into {choices_file}: [ports.{name}] with position and "
            f"velocity, of {', '.join(self._moving)}"
            for name, si in self.inputs.items()
            if si in FORCES and name not in self.motion
        ]
        untyped.remarks = (*f.remarks, *undeclared)
        untyped.period_s = f.period_s or type(self).period_s
        untyped.ports = {f"at_{name}": Port("command", si) for name, si in self.inputs.items()}
        for name, signals in self.motion.items():
            position, velocity = (self._moving[signal] for signal in signals)
            offered = {"position": position, "velocity": velocity}
            untyped.ports[f"at_{name}"] = Port("motion", self.inputs[name], offered)
        untyped.ports |= {f"read_{v.name}": Port("reading", v.si) for v in f.outputs}

    def _parameter(self, v: FmuVariable) -> Parameter:
        count = len(self.file.parameters)
        wanted = v.name in self.free if self.free else count <= MOST_FREE
        return stated_parameter(v.name, v.start, v.unit, fitted=wanted and v.start != 0.0)

    @property
    def _moving(self) -> dict[str, str]:
        """Candidates for positions and velocities: outputs and seen states, with units."""
        return {s.name: s.unit for s in self.states} | self.outputs

    def _check_names(self) -> None:
        """Check the names in the user's tables."""
        table, where = choices_path(Path(self.file.path)), self.file.path
        if self.motion is self.file.motion and table.exists():
            where = str(table)
        parameters = [v.name for v in self.file.parameters]
        moving = [signal for signals in self.motion.values() for signal in signals]
        known = [(name, list(self.inputs), "input") for name in self.motion]
        known += [(signal, list(self._moving), "output") for signal in moving]
        known += [(name, parameters, "parameter") for name in self.free]
        for name, names, what in known:
            if name not in names:
                section = "free" if what == "parameter" else "motion"
                raise FileError(
                    f"{where}: {section} names {name!r}, but the FMU has no such {what}",
                    nearest(name, names) or f"{what}s: {', '.join(names)}",
                )
        for name, (position, velocity) in self.motion.items():
            rate, given = quotient(self._moving[position], "s"), self._moving[velocity]
            if rate and given and rate != given and position != velocity:
                raise FileError(
                    f"{where}: {velocity!r} [{given}] is not the velocity of {position!r} "
                    f"[{self._moving[position]}], which {name!r} acts along",
                    f"a velocity there is in {rate}",
                )

    # ---- equations -------------------------------------------------------------------------------

    def drive(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        into: dict[str, Number] = {}
        for name in self.inputs:
            signals = {}
            if name in self.motion:
                position, velocity = self.motion[name]
                signals = {"position": getattr(x, position), "velocity": getattr(x, velocity)}
            into[name] = port(f"at_{name}", getattr(u, name), **signals)
        return into

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {name: port(f"read_{name}", getattr(x, name)) for name in self.outputs}

    # ---- the simulation --------------------------------------------------------------------------

    @cached_property
    def _process(self) -> FmuProcess:
        return FmuProcess(self.file)

    def far_runner(self) -> FarRunner:
        return self._process

    def steps(
        self, x: Array, f: Array, p: Array, h: float, into: tuple[str, ...]
    ) -> tuple[Array, Array]:
        return self._process.steps(x, f, p, h)

    def reads(self, x: Array, p: Array) -> Array:
        return self._process.reads(x, p) if self.readings else np.empty((len(x), 0))
