"""Instance of an FMU in the process that holds it, with the data for calls from compiled code."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.rigs.simulators.fmi_kernels import (
    ENDED,
    GET_X,
    NAMES,
    RESTORE,
    SAID,
    SAVE,
    FmiModel,
    change_inputs,
    get_outputs,
    settle,
)

_STATUSES = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
FATAL = 4


class FmuInstance:
    """An instance. description: entries of `FmuFile.request`, and the unpacked FMU's folder."""

    def __init__(self, description: dict[str, Any], number: int) -> None:
        from fmpy import fmi2, fmi3

        self.about, self.version = description, description["version"]
        module = fmi2 if self.version == 2 else fmi3
        kind = "Model" if description["exchange"] else "Slave"
        self.fmu = getattr(module, f"FMU{self.version}{kind}")(
            guid=description["token"],
            unzipDirectory=description["folder"],
            modelIdentifier=description["identifier"],
            instanceName=f"pamid_{number}",
        )
        self.fmu.instantiate()
        self.fresh = True
        self.past: Any = None  # steps up to its state, for an FMU that saves no states
        self.handle = int(getattr(self.fmu.component, "value", self.fmu.component))
        self.x, self.due = np.zeros(len(description["states"])), np.full(1, np.inf)

    def model(self) -> FmiModel:
        """The FMU for compiled code; the same for all of its instances."""
        about, dll = self.about, self.fmu.dll
        places = []
        for name in NAMES[self.version].split():
            function: Any = getattr(dll, f"fmi{self.version}{name}", None)
            places.append(ctypes.cast(function, ctypes.c_void_p).value or 0)
        inputs, outputs, states, rates = (
            np.array(about[name], np.uint32) for name in ("inputs", "outputs", "states", "rates")
        )
        return FmiModel(
            np.array(places, np.int64),
            self.version,
            about["exchange"],
            inputs,
            outputs,
            states,
            rates,
            about["indicators"],
            np.array(about["nominals"], float),
            np.zeros(4, np.int64),
        )

    # ---- what happens once a run -----------------------------------------------------------------

    def put(self, references: list[int], values: Array) -> None:
        if references:
            (self.fmu.setReal if self.version == 2 else self.fmu.setFloat64)(
                references, values.tolist()
            )

    def restart(self, m: FmiModel, p: Array) -> None:
        """Restart at time 0 with these parameters."""
        fmu = self.fmu
        if not self.fresh:
            fmu.reset()
        self.fresh, self.past = False, None
        if self.version == 2:
            fmu.setupExperiment(startTime=0.0)
        self.put(self.about["parameters"], p)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        if self.about["exchange"]:
            self.check(m, settle(m, self.handle, True, self.due))
            self.x = self.states_of(m)

    def change_parameters(self, m: FmiModel, places: list[int], p: Array) -> None:
        """Change these parameters, which the FMU allows while it runs."""
        references = [self.about["parameters"][i] for i in places]
        if self.about["exchange"]:
            self.fmu.enterEventMode()
        self.put(references, p[places])
        if self.about["exchange"]:
            self.check(m, settle(m, self.handle, False, self.due))

    def states_of(self, m: FmiModel) -> Array:
        states = np.zeros(len(m.states))
        if len(states):
            pointer = states.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
            self._call(m, GET_X, pointer, ctypes.c_size_t(len(states)))
        return states

    def outputs(self, m: FmiModel) -> Array:
        outputs = np.zeros(len(m.outputs))
        self.check(m, get_outputs(m, self.handle, outputs))
        return outputs

    def outputs_at(self, m: FmiModel, x: Array) -> Array:
        """Outputs at the states x with all inputs zero."""
        none = np.zeros(len(m.inputs))
        self.check(m, change_inputs(m, self.handle, 0.0, none, x.copy(), self.due))
        return self.outputs(m)

    # ---- states ----------------------------------------------------------------------------------

    def save(self, m: FmiModel, address: int = 0) -> int:
        """Save the state and return its address; the memory of an earlier state is reused."""
        state = ctypes.c_void_p(address or None)
        self._call(m, SAVE, ctypes.byref(state))
        return int(state.value or 0)

    def restore(self, m: FmiModel, address: int) -> None:
        self._call(m, RESTORE, ctypes.c_void_p(address))

    def free(self, address: int) -> None:
        name = "FreeFMUstate" if self.version == 2 else "FreeFMUState"
        state = ctypes.c_void_p(address)
        getattr(self.fmu.dll, f"fmi{self.version}{name}")(self.handle, ctypes.byref(state))

    # ---- failures --------------------------------------------------------------------------------

    def _call(self, m: FmiModel, place: int, *given: Any) -> None:
        types = (
            ctypes.c_size_t if isinstance(a, ctypes.c_size_t) else ctypes.c_void_p for a in given
        )
        kind = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, *types)
        status = kind(int(m.at[place]))(self.handle, *given)
        if status >= 2:
            m.report[0] = place
            self.check(m, status)

    def check(self, m: FmiModel, status: int, at_s: float | None = None) -> None:
        if status != 0:
            raise RuntimeError(why(m, status, at_s))


def why(m: FmiModel, status: int, at_s: float | None = None) -> str:
    """Text of a status."""
    when = "" if at_s is None else f", at {at_s:.4g} s"
    if status <= ENDED:
        return SAID[status] + when
    name = f"fmi{m.version}{NAMES[m.version].split()[m.report[0]]}"
    word = _STATUSES[status] if status < len(_STATUSES) else str(status)
    return f"{name} returned fmi{m.version}{word}{when}"
