"""Ahead-of-time compilation for the first command: the integration in time, the networks, the
shipped rigs' equations.

    python -m pamid.api.compiling

`make` does it when it installs. Without it the first command compiles everything once and takes
longer. Compiled code lies next to the package or in the user's cache
(`pamid.engine.numba_cache`, `pamid.engine.jit_cache`); what has been compiled before is left.
"""

from __future__ import annotations

import importlib

import numpy as np

from pamid.base.progress import ProgressLine
from pamid.engine.block_tridiagonal import eliminate
from pamid.engine.program import Program, Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.model.assembly import Assembly
from pamid.model.attachment import attachments
from pamid.model.registry import effects, rigs

#: its functions are compiled when it is imported
_EAGER = "pamid.engine.recurrence_kernels"
#: the rig of the recording that is shipped, and of the demonstration
_FIRST = "one-dof"


def compile_ahead() -> None:
    """Compile all of it, with a line of progress on stderr."""
    shipped = {name: kind() for name, kind in sorted(rigs().items())}
    rig = shipped[_FIRST]
    models = {
        f"{name}{' with background' if background else ''}": Assembly(r, background=background)
        for name, r in shipped.items()
        for background in (False, True)
    } | {
        f"{_FIRST} with {attachment.label}": Assembly(rig, (attachment,), background=True)
        for attachment in attachments(rig, effects().values())
    }
    with ProgressLine("compiling, once", len(models) + 2, in_logs=True) as line:
        line.update(0, "networks")
        importlib.import_module(_EAGER)
        line.update(1, "integration in time")
        # A single sample; the numbers are of no interest, nor is a state that runs away.
        assembly = Assembly(rig)
        program, p, period = assembly.program, assembly.values(), assembly.rig.period_s
        memory = program.memory(assembly.start(p), period_s=period)
        u = np.zeros((1, len(program.inputs)))
        program.rate_matrix(memory, u[0], p, period_s=period)
        program.run(memory, SampledInputs(u, period), p, stepping=Stepping())
        lanes = assembly.lane_program
        state, implicit = assembly.start(p)[:, None], Stepping(1, implicit=True)
        lanes.run(lanes.memory(state), SampledInputs(u, period), p, stepping=implicit)
        eliminate(np.ones((1, 1, 1)), np.zeros((0, 1, 1)), np.ones((1, 1, 1)), 0.0)
        for done, (name, model) in enumerate(models.items(), start=2):
            line.update(done, name)
            _compile(model.for_fitting())


def _compile(assembly: Assembly) -> None:
    """The equations of a model, by themselves, with partials and on lanes."""
    program, lanes, p = assembly.program, assembly.lane_program, assembly.values()
    assert isinstance(program, Program)  # no shipped rig is stepped
    program.code.at(p, partials=True)
    x, u = np.zeros((len(lanes.states), 1)), np.zeros((0, len(program.inputs)))
    lanes.run(lanes.memory(x), SampledInputs(u, assembly.rig.period_s), p)


if __name__ == "__main__":
    compile_ahead()
