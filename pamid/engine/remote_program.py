"""A stepped program in another process: its parts as plain data, and its runs as rows of numbers.

A simulator in another process gets each run as a whole: an exchange at every sample would cost two
changes of process each.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.program import (
    Memory,
    ModuleTexts,
    PartialsModule,
    PlainModule,
    Program,
    ProgramCode,
    Stepping,
)
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.shadow_simulators import Carrier
from pamid.engine.simulator import Simulator
from pamid.engine.stepped import Course, SteppedProgram

_LENGTH = struct.Struct("<q")


def program_data(program: SteppedProgram) -> dict[str, Any]:
    """Return the program as JSON, the input of `rebuilt_program`."""
    a = program.around
    text = a.code.text
    return {
        "phases": [None, *text.phases[1:]],
        "plain": text.plain._asdict(),
        "partials": text.partials._asdict(),
        "tables": [a.states, a.inputs, a.parameters, a.outputs, a.cells],
        "delays": a.delays,
        "sensitive": sorted(a.sensitive),
        "linear": a.linear,
        "sizes": [
            program.readings,
            program.simulated,
            program.forces,
            program.simulator_parameters,
        ],
    }


def rebuilt_program(data: dict[str, Any], simulator: Simulator | Carrier) -> SteppedProgram:
    """Rebuild a program around another simulator, with code from the cache where it is there."""
    states, inputs, parameters, outputs, cells = map(tuple, data["tables"])
    texts = ModuleTexts(
        data["phases"], PlainModule(**data["plain"]), PartialsModule(**data["partials"])
    )
    around = Program(
        states,
        inputs,
        parameters,
        outputs,
        cells,
        tuple(data["delays"]),
        frozenset(data["sensitive"]),
        tuple(data["linear"]),
        ProgramCode(texts),
    )
    return SteppedProgram(simulator, around, *data["sizes"])


@dataclass(frozen=True)
class Parcel:
    """Arrays in a row of numbers, with their shapes for JSON."""

    about: dict[str, Any]
    numbers: Array

    @property
    def message(self) -> bytes:
        """The header as JSON behind its length, padded to whole numbers, and the numbers."""
        header = json.dumps(self.about).encode()
        header += b" " * (-len(header) % 8)
        return _LENGTH.pack(len(header)) + header + self.numbers.tobytes()

    @classmethod
    def of(cls, message: bytes) -> Parcel:
        """The parcel of a message."""
        end = _LENGTH.size + _LENGTH.unpack_from(message)[0]
        return cls(json.loads(message[_LENGTH.size : end]), np.frombuffer(message, offset=end))

    def arrays(self) -> Iterator[Any]:
        at = 0
        for shape in self.about["shapes"]:
            if shape is None:
                yield None
                continue
            size = int(np.prod(shape))
            yield self.numbers[at : at + size].reshape(shape).copy()
            at += size


def packed(about: dict[str, Any], arrays: list[Array | None]) -> Parcel:
    """Pack arrays into a parcel; None stays None."""
    shapes = [None if a is None else a.shape for a in arrays]
    # A row of float64 is written and read as a whole. Integers up to 2^53 survive it exactly.
    flat = [np.ravel(a).astype(float) for a in arrays if a is not None]
    return Parcel({**about, "shapes": shapes}, np.concatenate([np.zeros(0), *flat]))


def run_request(memory: Memory, course: Course) -> Parcel:
    """Pack a run, without the saved states of the simulator."""
    inputs = course.inputs
    about = {
        "times": [inputs.period_s, inputs.time_s],
        "stepping": [course.stepping.substeps, course.stepping.implicit],
        "begin": memory.begin,
        "join": memory.join,
    }
    given: list[Any] = [inputs.u, course.p, course.columns, course.weights, inputs.after]
    return packed(about, [*memory.arrays(), *given])


def run_of(parcel: Parcel) -> tuple[Memory, Course]:
    """Unpack a run from `run_request`."""
    x, cells, past, S, buffers, buffer_S, heads, *rest = parcel.arrays()
    u, p, columns, weights, after = rest
    about = parcel.about
    heads = heads.astype(np.int64)
    memory = Memory(
        x, cells, past, S, buffers, buffer_S, heads, bool(about["begin"]), bool(about["join"])
    )
    places = None if columns is None else columns.astype(np.int64)
    substeps, implicit = about["stepping"]
    period_s, time_s = about["times"]
    inputs = SampledInputs(u, period_s, time_s, after)
    return memory, Course(inputs, p, Stepping(substeps, implicit), places, weights)


def run_answer(memory: Memory, outcome: tuple[Array, Array, int]) -> Parcel:
    """Pack the result of a run, and its memory at the end."""
    return packed({"bad": outcome[2]}, [*outcome[:2], *memory.arrays()])


def take_answer(memory: Memory, parcel: Parcel) -> tuple[Array, Array, int]:
    """Unpack `run_answer` into the memory."""
    Y, JY, *memory_arrays = parcel.arrays()
    # In place: the caller and its drivers hold views of these arrays.
    for array, new in zip(memory.arrays(), memory_arrays, strict=True):
        array[...] = new
    memory.begin = memory.join = False
    return Y, JY, int(parcel.about["bad"])
