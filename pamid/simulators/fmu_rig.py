"""An FMU as a rig: its inputs and outputs are ports, its parameters are fitted.

    class Drive(FmuRig):
        path = "drive.fmu"
        motion = {"torque_n_m": ("angle_rad", "speed_rad_per_s")}

In a rig file, `motion` declares inputs that are forces or torques, with the outputs that are the
position and the velocity there: effects of mechanics then act at the port. The file alone, `--rig
drive.fmu`, has command ports and reading ports. Its binary is run.
"""

from __future__ import annotations

import os
import sys
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from pamid.base.errors import FileError, nearest
from pamid.engine.carried import Carrier
from pamid.model.parameter import Parameter
from pamid.model.rig import Port
from pamid.model.step_rig import StepRig
from pamid.simulators.fmu_file import FmuFile, FmuVariable, read_fmu
from pamid.simulators.fmu_process import FmuProcess
from pamid.simulators.mujoco_parameters import stated
from pamid.symbolic.vocabulary import Number

MOST_FREE = 20  # parameters that are fitted without a word: of more, those in `free` alone


class FmuRig(StepRig):
    """A rig made of an FMU."""

    name = "fmu"
    carries = True
    # beside the rig's own file, or from the folder in which it is run
    path: ClassVar[str] = ""
    # input that is a force or torque -> outputs: position and velocity there
    motion: ClassVar[dict[str, tuple[str, str]]] = {}
    # parameters to fit, where not all are
    free: ClassVar[tuple[str, ...]] = ()

    def __init__(self, file: FmuFile | None = None) -> None:
        own: Any = self  # tables that a class usually holds
        self.file = f = file or read_fmu(_beside(type(self), self.path))
        own.name = f.name if type(self) is FmuRig else type(self).name
        own.inputs = {v.name: v.si for v in f.inputs.variables}
        own.outputs = {v.name: v.si for v in f.outputs.variables}
        own.readings = dict(self.outputs)
        own.parameters = tuple(map(self._parameter, f.parameters.variables))
        own.remarks = f.remarks
        own.period_s = f.period_s or type(self).period_s
        self._check_motion()
        own.ports = {f"at_{v.name}": self._way_in(v) for v in f.inputs.variables} | {
            f"read_{v.name}": Port("reading", v.si) for v in f.outputs.variables
        }

    def _parameter(self, v: FmuVariable) -> Parameter:
        count = len(self.file.parameters.variables)
        wanted = v.name in self.free if self.free else count <= MOST_FREE
        found = stated(v.name, v.start, v.unit, fitted=wanted and v.start != 0.0)
        return found

    def _way_in(self, v: FmuVariable) -> Port:
        if v.name not in self.motion:
            return Port("command", v.si)
        position, velocity = (self.outputs[name] for name in self.motion[v.name])
        return Port("motion", v.si, {"position": position, "velocity": velocity})

    def _check_motion(self) -> None:
        for name, signals in self.motion.items():
            for one, known, what in (
                (name, self.inputs, "input"),
                *((signal, self.outputs, "output") for signal in signals),
            ):
                if one not in known:
                    raise FileError(
                        f"{self.file.path}: motion names {one!r}, which is no {what} of it",
                        nearest(one, list(known)) or f"{what}s: {', '.join(known)}",
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

    def carrier(self) -> Carrier:
        return self._process

    @cached_property
    def _process(self) -> FmuProcess:
        return FmuProcess(self.file)


def _beside(kind: type, path: str) -> Path:
    """A path that is written in a rig file, from the folder of that file."""
    home = getattr(sys.modules.get(kind.__module__), "__file__", None)
    return Path(os.path.dirname(home) if home else "") / path
