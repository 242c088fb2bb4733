"""`pamid.train_residual`: a network for what a fitted model leaves over."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

from pamid.api.options.record import verb
from pamid.api.options.training import TrainingArguments
from pamid.api.workers import OpenedRun
from pamid.base.card import Cells, card, html_table, number, paragraph, text_table
from pamid.base.errors import DataError, PamidError, UsageError
from pamid.base.progress import progress_steps
from pamid.base.run_folder import FIT_FILE, NETWORK_FILE, RESIDUAL_FILE, Run
from pamid.model.registry import resolved_rig
from pamid.networks.correction.output_network import (
    CHECKPOINT_FILE,
    NetworkChoice,
    train_correction,
    write_correction,
)
from pamid.networks.correction.port_network import (
    entry_of,
    origin_of,
    train_at_port,
)
from pamid.networks.correction.residual_data import (
    CAUSES,
    MODEL_COLUMNS,
    read_residual_data,
)
from pamid.networks.network_training import TrainingStep
from pamid.networks.trained_network import network_kinds
from pamid.networks.training_problem import (
    PAPER_DAMPING,
    PAPER_ITERATIONS,
    Damping,
    TrainingOptions,
)

if TYPE_CHECKING:
    from pamid.recording.plot import NotebookFigure

EVIDENCE = ("every-sample", "independent-samples")
USUAL_ITERATIONS = 1000


@dataclass(frozen=True, kw_only=True)
class NetworkResult(OpenedRun):
    """A network that corrects a fitted model, and its held-out errors.

    folder: of the run; kind: "elman", "anfis" or "narx"; on: the model whose residual it was
    trained on, "refit" or "causes"; target: that residual in words; inputs: its columns; weights:
    number of weights; iterations, why, converged: of the training; interrupted: the training was
    interrupted, and this is its network so far; stuck: it ended early without convergence; errors:
    channel -> "refitted", "with_cause" (of a network on the model with the causes), "with_network"
    ... -> mean absolute error in the channel's unit.
    """

    result_file: ClassVar[str] = NETWORK_FILE

    kind: str
    on: str
    target: str
    inputs: tuple[str, ...]
    weights: int
    iterations: int
    why: str
    converged: bool
    interrupted: bool
    stuck: bool
    errors: dict[str, dict[str, float]]

    def plot_training(self) -> NotebookFigure:
        """Error, effective number of parameters and damping over the iterations."""
        return self._figure("course of a training")

    def __repr__(self) -> str:
        return f"<NetworkResult {self._headline()}>\n{text_table(self._rows())}"

    def _repr_html_(self) -> str:
        return card(
            self._headline(),
            paragraph(f"Inputs: {', '.join(self.inputs)}."),
            html_table(self._rows()),
        )

    def _headline(self) -> str:
        return (
            f"{self.kind}, {self.weights} weights, for {self.target}: {self.iterations} "
            f"iterations, {self.why}"
        )

    def _rows(self) -> Cells:
        models = ("refitted", *(["with_cause"] if self.on == CAUSES else []), "with_network")
        rows = [(c, *(number(e.get(name)) for name in models)) for c, e in self.errors.items()]
        heads = (name.replace("_", " ") for name in models)
        return ("held-out mean absolute error", *heads), rows


@verb(TrainingArguments)
def train_residual(arguments: TrainingArguments) -> NetworkResult:
    """Train a network on the residual of a run's model, and judge it on held-out data.

    The files of the network are added to the run. An interrupt ends the training with its best
    network so far.

    Raises
    ------
    PamidError
        The run or the call is wrong, or the training had no result.
    """
    a = arguments
    if a.evidence not in EVIDENCE:
        raise UsageError(f"evidence={a.evidence!r} must be {' or '.join(EVIDENCE)}.")
    if a.on not in MODEL_COLUMNS:
        raise UsageError(f"on={a.on!r} must be {' or '.join(MODEL_COLUMNS)}.")
    damping = _damping(a)
    iterations = most_iterations(a)
    wanted = NetworkChoice(a.network, a.sizes)
    source = OpenedRun.of(a.run)
    run = Run.open(source.folder)
    residual = read_residual_data(
        run.folder, a.channel, tuple(a.inputs), on=a.on, replay=a.at != "output"
    )
    rig = resolved_rig(a.rig)
    if a.at == "output" and rig is not None:
        raise UsageError("--rig belongs to --port PORT: at the output no rig is needed.")
    if a.at != "output":
        origin = origin_of(source.folder, source.code[0] if rig is None else rig, a.on)
        entry = entry_of(origin.evidence.rig, a.at)
    run.begin_step(
        command=a.command or ["pamid.train_residual", str(run.folder)],
        seed=a.seed,
        inputs=[run.folder / FIT_FILE, run.folder / RESIDUAL_FILE],
        options={
            "network": a.network,
            **a.sizes,
            "iterations": iterations,
            "starts": a.starts,
            "evidence": a.evidence,
            "at": a.at,
            "on": a.on,
            "as_in_paper": a.plain,
            "damping": asdict(damping),
            "resume": a.resume,
            "channel": residual.channel,
            "inputs": list(residual.inputs),
        },
    )
    try:
        with progress_steps(a.progress, "train-residual", iterations) as (show, count):

            def step_done(step: TrainingStep, start: int) -> None:
                which = f"start {start + 1} of {a.starts}, " if a.starts > 1 else ""
                about_step = f"MSE {step.mse:.4g}, gamma {step.gamma:.1f}, mu {step.mu:.1g}"
                count(step.iteration, which + about_step)

            options = TrainingOptions(
                independent=a.evidence == "independent-samples",
                plain=a.plain,
                damping=damping,
                device=a.device,
                iterations=iterations,
                seed=a.seed,
                starts=a.starts,
                threads=a.jobs or os.cpu_count() or 1,
                checkpoint=run.path(CHECKPOINT_FILE),
                resume=a.resume,
                progress=step_done,
            )
            if a.at == "output":
                correction = train_correction(residual, wanted, options)
            else:
                correction = train_at_port(residual, origin.model(), entry, wanted, options, show)
            about = write_correction(run, correction)
    except (PamidError, KeyboardInterrupt) as error:
        run.finish("failed" if isinstance(error, PamidError) else "interrupted")
        raise
    run.finish("interrupted" if correction.interrupted else "done")
    training = about["training"]
    return NetworkResult(
        folder=source.folder,
        kind=about["kind"],
        on=about["on"],
        target=about["target"],
        inputs=tuple(input_["name"] for input_ in about["inputs"]),
        weights=about["n_weights"],
        iterations=training["iterations"],
        why=training["why"],
        converged=training["converged"],
        interrupted=correction.interrupted,
        stuck=not training["converged"] and training["iterations"] < iterations,
        errors={
            channel: {k: v for k, v in errors.items() if isinstance(v, float)}
            for channel, errors in about["mae"].items()
        },
        _home=source._home,
    )


def most_iterations(arguments: TrainingArguments) -> int:
    default = PAPER_ITERATIONS if arguments.plain else USUAL_ITERATIONS
    return default if arguments.iterations is None else arguments.iterations


def _damping(arguments: TrainingArguments) -> Damping:
    """Schedule of mu: that of the paper or ours, with the given values in their place."""
    values = {
        name: getattr(arguments, f"mu{ending}")
        for name, ending in (
            ("start", ""),
            ("increase", "_increase"),
            ("decrease", "_decrease"),
            ("largest", "_largest"),
        )
    }
    given = {name: value for name, value in values.items() if value is not None}
    try:
        return replace(PAPER_DAMPING if arguments.plain else Damping(), **given)
    except DataError as error:
        raise UsageError(
            error.message,
            "--mu lies below --mu-largest, --mu-increase above 1, --mu-decrease between 0 and 1.",
        ) from None


def network_words(kind: str, sizes: dict[str, Any]) -> str:
    """Kind and sizes in the usual notation: elman 5-10-1; anfis 5x5 = 25 rules."""
    return network_kinds()[kind](**sizes).words()
