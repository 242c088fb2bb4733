"""pamid on a public benchmark with a residual network on top: the grey box of public_ours.py, and
what it leaves of the one record's free run taught to a network by what `pamid train-residual`
calls.

    python public_network.py SET FOLDER [quick]

The network is given the rig's inputs and what the model puts out, never a measured output; it
begins at rest with a record's first sample, and its value is added to the model's. (The command
itself trains on windows that each begin at an estimated state: here it is the free run that is
judged, and so the free run that is learnt.)
"""

import tempfile
from pathlib import Path

import numpy as np
from free_run_fit import fit_free_run, free
from public_ours import MODELS, columns_of, record_for_pamid
from public_sets import PublicSet, Record, asked, judge, read_set, tell

import pamid
from pamid.networks.correction.output_network import NetworkChoice, train_correction
from pamid.networks.correction.residual_data import ResidualData, Segment, derived
from pamid.networks.training_problem import TrainingOptions

HIDDEN, STARTS, STEPS = 10, 4, 300
LEARNT = 0.9  # of the record; the rest is held out, as the training asks for


def left_over(one: PublicSet, fit: Record, columns: dict, modelled: np.ndarray) -> ResidualData:
    """What the model leaves of the record, as read from a run folder."""
    channel = one.columns[1]
    own, edge = derived(channel, "refitted"), int(LEARNT * len(fit.u))
    return ResidualData(
        channel=channel,
        model="replay",
        columns={**columns, channel: fit.y, own: modelled},
        modelled=own,
        inputs=(*columns, own),
        stretches=(Segment(slice(0, edge), 0), Segment(slice(edge, len(fit.u)), 1)),
        washout=one.start,
        period_s=fit.period_s,
        notes=(),
    )


def main() -> None:
    one, folder, quick = asked()
    rig, effects = MODELS[one.name]
    steps = STEPS // 10 if quick else STEPS
    with tempfile.TemporaryDirectory() as home:
        record = record_for_pamid(one, folder, Path(home))
        model = free(fit_free_run(str(rig), effects, record, one.start))
    fit, tests = read_set(folder, one)

    def modelled(u, y0):
        columns = columns_of(one.name, one.columns[0], u)
        return columns, model.run(columns, y0, fit.period_s)

    leftover = left_over(one, fit, *modelled(fit.u, fit.y[: one.start]))
    found = train_correction(
        leftover,
        wanted=NetworkChoice("elman", {"hidden": HIDDEN}),
        options=TrainingOptions(iterations=steps, starts=STARTS, threads=1),
    )
    network, taken = found.trained, len(found.training.trace["iteration"]) - 1

    def run(u, y0):
        columns, y = modelled(u, y0)
        return y + network.predict({**columns, leftover.modelled: y})

    remark = f"the same with elman {HIDDEN} units, {STARTS} starts, {taken} steps"
    tell(f"pamid {pamid.__version__} + network", judge(one, tests, run), remark)


if __name__ == "__main__":
    main()
