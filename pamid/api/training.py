"""`pamid.train_residual`: a network for what a fitted model leaves over."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pamid.api.results import FitResult
from pamid.api.workers import RunHome
from pamid.base.card import Cells, card, html_table, number, paragraph, text_table
from pamid.base.errors import DataError, PamidError, UsageError
from pamid.base.files import PathLike
from pamid.base.json_file import read_json
from pamid.base.progress import Progress, ShowProgress, progress_steps
from pamid.base.run_folder import FIT_FILE, NETWORK_FILE, RESIDUAL_FILE, Run
from pamid.correction.output_network import (
    CHECKPOINT_FILE,
    NetworkChoice,
    train_correction,
    write_correction,
)
from pamid.correction.port_network import (
    entry_of,
    origin_of,
    train_at_port,
    write_port_correction,
)
from pamid.correction.residual_data import (
    CAUSES,
    MODEL_COLUMNS,
    REFIT,
    ResidualData,
    read_residual_data,
)
from pamid.model.registry import RigLike, resolved_rig
from pamid.model.rig import Rig
from pamid.networks.network_training import TrainingStep
from pamid.networks.training_problem import (
    PAPER_DAMPING,
    PAPER_ITERATIONS,
    Damping,
    TrainingOptions,
)
from pamid.report.load import RunData, load_run

if TYPE_CHECKING:
    from pamid.recording.plot import NotebookFigure

EVIDENCE = ("every-sample", "independent-samples")
USUAL_ITERATIONS = 1000
#: trains and writes; network.json, and whether it was interrupted
Trainer = Callable[
    [Run, ResidualData, Progress, NetworkChoice, TrainingOptions], tuple[dict[str, Any], bool]
]


@dataclass(frozen=True)
class NetworkResult:
    """A network that corrects a fitted model, and what it is worth on what was held out.

    folder: of the run; kind: "elman", "anfis" or "narx"; on: the model whose residual it was
    trained on, "refit" or "causes"; target: that residual in words; inputs: what it is given;
    weights: their number; iterations, why, converged: of the training; interrupted: it was ended
    early, and is what it had reached; errors: channel -> "refitted", "with_cause" (of a network on
    the model with the causes), "with_network" ... -> mean absolute error in the channel's unit.
    """

    folder: Path
    kind: str
    on: str
    target: str
    inputs: tuple[str, ...]
    weights: int
    iterations: int
    why: str
    converged: bool
    interrupted: bool
    errors: dict[str, dict[str, float]]
    _home: RunHome = field(repr=False)

    @cached_property
    def data(self) -> RunData:
        """All that the files of the run hold."""
        return load_run(self.folder)

    def to_dict(self) -> dict[str, Any]:
        """JSON object of the command: network.json."""
        content: dict[str, Any] = read_json(self.folder / NETWORK_FILE)
        return content

    def plot_training(self) -> NotebookFigure:
        """Error, effective number of parameters and damping over the iterations."""
        from pamid.api.plots import training_figure

        return training_figure(self.data)

    def plot_worst_window(self, channel: str | None = None) -> NotebookFigure:
        """Measured, refitted and corrected over the held-out window in which the refitted model
        errs most."""
        from pamid.api.plots import worst_window_figure

        return worst_window_figure(self.data, channel)

    def __repr__(self) -> str:
        return f"<NetworkResult {self._headline()}>\n{text_table(self._rows())}"

    def _repr_html_(self) -> str:
        return card(
            self._headline(),
            paragraph(f"It is given {', '.join(self.inputs)}."),
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


def train_residual(
    run: FitResult | PathLike,
    *,
    network: str = "elman",
    iterations: int | None = None,
    seed: int = 0,
    starts: int = 1,
    jobs: int | None = None,
    evidence: str = "every-sample",
    device: str | None = None,
    at: str = "output",
    on: str = REFIT,
    rig: RigLike | None = None,
    channel: str | None = None,
    inputs: Sequence[str] = (),
    resume: bool = False,
    as_in_paper: bool = False,
    mu: float | None = None,
    mu_increase: float | None = None,
    mu_decrease: float | None = None,
    mu_largest: float | None = None,
    progress: ShowProgress = None,
    command: Sequence[str] = (),
    **sizes: int | None,
) -> NetworkResult:
    """Train a network on the residual of a run's model, and judge it on held-out data.

    The files of the network are added to the run. An interrupt ends the training with its best
    network so far.

    Parameters
    ----------
    run
        Result, or run folder.
    network
        "elman", "anfis" or "narx".
    sizes
        hidden: units of elman or narx (default 10, or as many as the samples decide); sets:
        membership sets per input of anfis (default: up to 5, with no more than 64 rules).
    iterations
        Levenberg-Marquardt steps at most, per start. Default: 1000; 5000 as in the paper.
    seed, starts
        Seed and number of random starts.
    jobs
        Cores. Default: all. The result does not depend on it.
    evidence
        Samples that the regularisation counts: "every-sample" or "independent-samples".
    device
        Device on which torch computes the passes of elman or narx, all starts together: "cpu",
        "cuda", "cuda:1". Default: the compiled kernels, on the processor.
    at
        "output", or the port of the rig at which the correction enters the equations.
    rig
        With a port: the rig file of the run (it is run), or the Rig.
    on
        Model whose residual is learnt: "refit", or "causes", the one with the causes of a
        diagnosis, replayed on recorded commands.
    channel
        Output to correct. Default: angle_deg, else the first of the run.
    inputs
        Columns of residual.csv that the network receives.
    resume
        Go on from where the same training was interrupted.
    as_in_paper
        Plain Levenberg-Marquardt steps from a random start, without acceleration, variable
        projection or a bound on the context; mu by fixed factors; 5000 steps.
    mu, mu_increase, mu_decrease, mu_largest
        Damping: initial value (default 0.005), factor after a rejected step (default 3; 10 as in
        the paper), factor after an accepted step (default: by the gain ratio; 0.1 as in the
        paper), and the value at which the training stops (default 1e10).

    Raises
    ------
    PamidError
        The run or the call is wrong, or the training had no result.
    """
    if evidence not in EVIDENCE:
        raise UsageError(f"evidence={evidence!r}: take {' or '.join(EVIDENCE)}.")
    if on not in MODEL_COLUMNS:
        raise UsageError(f"on={on!r}: take {' or '.join(MODEL_COLUMNS)}.")
    damping = _damping(as_in_paper, mu, mu_increase, mu_decrease, mu_largest)
    if iterations is None:
        iterations = PAPER_ITERATIONS if as_in_paper else USUAL_ITERATIONS
    wanted = NetworkChoice(network, sizes)
    home = run._home if isinstance(run, FitResult) else RunHome(Path(run))
    folder = Run.open(home.folder)
    leftover = read_residual_data(home.folder, channel, tuple(inputs), on=on, replay=at != "output")
    trainer = _trainer(run, home.folder, at, on, resolved_rig(rig))
    folder.begin_step(
        command=command or ["pamid.train_residual", str(home.folder)],
        seed=seed,
        inputs=[home.folder / FIT_FILE, home.folder / RESIDUAL_FILE],
        options={
            "network": network,
            **sizes,
            "iterations": iterations,
            "starts": starts,
            "evidence": evidence,
            "at": at,
            "on": on,
            "as_in_paper": as_in_paper,
            "damping": asdict(damping),
            "resume": resume,
            "channel": leftover.channel,
            "inputs": list(leftover.inputs),
        },
    )
    course = TrainingOptions(
        independent=evidence == "independent-samples",
        plain=as_in_paper,
        damping=damping,
        device=device,
        iterations=iterations,
        seed=seed,
        starts=starts,
        threads=jobs or os.cpu_count() or 1,
        checkpoint=folder.path(CHECKPOINT_FILE),
        resume=resume,
    )
    about, interrupted = _trained(folder, leftover, trainer, wanted, course, progress)
    return _result(home, about, interrupted)


def _damping(
    as_in_paper: bool,
    start: float | None,
    increase: float | None,
    decrease: float | None,
    largest: float | None,
) -> Damping:
    """The paper's schedule of mu, or ours, with what is given in its place; UsageError where that
    is none."""
    given = {"start": start, "increase": increase, "decrease": decrease, "largest": largest}
    named = {name: value for name, value in given.items() if value is not None}
    try:
        return replace(PAPER_DAMPING if as_in_paper else Damping(), **named)
    except DataError as error:
        raise UsageError(
            error.message,
            "--mu lies below --mu-largest, --mu-increase above 1, --mu-decrease between 0 and 1.",
        ) from None


def _trainer(
    run: FitResult | PathLike, folder: Path, at: str, on: str, rig: str | Rig | None
) -> Trainer:
    """Trainer for an output or for a port; raises for unknown names."""
    if at == "output":
        if rig is not None:
            raise UsageError("--rig belongs to --port PORT: at the output no rig is needed.")
        return _at_output
    if rig is None and isinstance(run, FitResult):
        rig = run.code[0]
    origin = origin_of(folder, rig, on)
    entry = entry_of(origin.evidence.rig, at)

    def at_port(
        run: Run,
        leftover: ResidualData,
        show: Progress,
        wanted: NetworkChoice,
        course: TrainingOptions,
    ) -> tuple[dict[str, Any], bool]:
        correction = train_at_port(leftover, origin.model(), entry, wanted, course, show)
        return write_port_correction(run, correction), correction.interrupted

    return at_port


def _trained(
    run: Run,
    leftover: ResidualData,
    trainer: Trainer,
    wanted: NetworkChoice,
    course: TrainingOptions,
    progress: ShowProgress,
) -> tuple[dict[str, Any], bool]:
    """network.json, and whether the training was interrupted; the run is closed with how it
    ended."""
    try:
        with progress_steps(progress, "train-residual", course.iterations) as (show, count):
            course = replace(course, progress=_steps(count, course.starts))
            about, interrupted = trainer(run, leftover, show, wanted, course)
    except (PamidError, KeyboardInterrupt) as error:
        run.finish("failed" if isinstance(error, PamidError) else "interrupted")
        raise
    run.finish("interrupted" if interrupted else "done")
    return about, interrupted


def _at_output(
    run: Run, leftover: ResidualData, show: Progress, wanted: NetworkChoice, course: TrainingOptions
) -> tuple[dict[str, Any], bool]:
    correction = train_correction(leftover, wanted, course)
    return write_correction(run, correction), correction.interrupted


def _steps(count: Callable[[int, str], object], starts: int) -> Callable[[TrainingStep, int], None]:
    def step_done(step: TrainingStep, start: int) -> None:
        which = f"start {start + 1} of {starts}, " if starts > 1 else ""
        count(
            step.iteration, f"{which}MSE {step.mse:.4g}, gamma {step.gamma:.1f}, mu {step.mu:.1g}"
        )

    return step_done


def _result(home: RunHome, about: dict[str, Any], interrupted: bool) -> NetworkResult:
    training = about["training"]
    return NetworkResult(
        folder=home.folder,
        kind=about["kind"],
        on=about["on"],
        target=about["target"],
        inputs=tuple(input_["name"] for input_ in about["inputs"]),
        weights=about["n_weights"],
        iterations=training["iterations"],
        why=training["why"],
        converged=training["converged"],
        interrupted=interrupted,
        errors={
            channel: {k: v for k, v in errors.items() if isinstance(v, float)}
            for channel, errors in about["mae"].items()
        },
        _home=home,
    )
