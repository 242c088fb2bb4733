"""Arguments of `train_residual`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, fields, make_dataclass
from typing import TYPE_CHECKING, Any, Literal

from pamid.api.options.names import network_sizes
from pamid.api.options.record import (
    AnyPath,
    NetworkName,
    argument,
    in_python_only,
    option,
    seed_option,
)
from pamid.base.errors import join_words

if TYPE_CHECKING:
    from pamid.api.workers import OpenedRun
    from pamid.base.progress import ShowProgress
    from pamid.model.registry import RigLike

    @dataclass(frozen=True, kw_only=True)
    class NetworkSizes:
        """Sizes of the shipped kinds of networks."""

        hidden: int | None = None
        sets: int | None = None
else:

    def _size_fields() -> list[tuple[str, str, Any]]:
        """An option for every size of the kinds of networks."""
        owners: dict[str, list[str]] = {}
        for kind, sizes in network_sizes().items():
            for name in sizes:
                owners.setdefault(name, []).append(kind)
        options = []
        for name, kinds in sorted(owners.items()):
            least, most, text, default = network_sizes()[kinds[0]][name]
            text = f"{text} of {join_words(kinds, 'or')}. [default: {default}]"
            options.append((name, "int | None", option(None, text, least=least, most=most)))
        return options

    NetworkSizes = make_dataclass("NetworkSizes", _size_fields(), frozen=True, kw_only=True)


@dataclass(frozen=True)
class TrainingArguments(NetworkSizes):
    """Train a network on the residual of the model in the run folder RUN, and score it on held-out
    data.

    The residual is measured - model, or with --port PORT the missing input of the equations there.
    --on causes uses the model with the causes of a diagnosis.

    Writes network.json, network.npz and trace.csv, and adds the corrected model to residual.csv. An
    interrupted training keeps its state. --resume with the same options continues it, with the same
    result as without an interruption.
    """

    run: OpenedRun | AnyPath = argument("Result, or run folder.")
    _: KW_ONLY
    network: NetworkName = option("elman", f"Kind of network: {join_words(network_sizes(), 'or')}.")
    iterations: int | None = option(
        None,
        "Levenberg-Marquardt steps at most, for every start. [default: 1000, or 5000 with "
        "--preset paper]",
        least=0,
    )
    seed: int = seed_option(
        "The same run and seed give the same network on the same kind of processor. Other "
        "processors round differently, so a long training gives other weights."
    )
    starts: int = option(
        1,
        "Random starts. The worse half is dropped at iterations 10, 20, 40, 80 and 160, and the "
        "best start is kept.",
        least=1,
        most=1000,
    )
    jobs: int | None = option(
        None, "Cores to use; the result does not depend on it. [default: all]", least=1, most=256
    )
    evidence: Literal["every-sample", "independent-samples"] = option(
        "every-sample",
        "Number of samples for the regularisation: all samples, as in the first paper, or the much "
        "smaller effective number of independent samples of a correlated residual.",
    )
    preset: Literal["paper"] | None = option(
        None,
        "paper: train as in the first paper, with plain Levenberg-Marquardt steps from a random "
        "start (Nguyen-Widrow), without acceleration, without a linear solution of the output "
        "weights, without a bound on the context, with fixed factors for mu and 5000 steps. The "
        "derivative through time stays exact.",
    )
    as_in_paper: bool = option(False, "Earlier name of --preset paper.", click={"hidden": True})
    mu: float | None = option(None, "Initial damping. [default: 0.005, as in MATLAB and the paper]")
    mu_increase: float | None = option(
        None, "Factor of mu after a rejected step. [default: 3; 10 with --preset paper]"
    )
    mu_decrease: float | None = option(
        None,
        "Factor of mu after an accepted step. [default: by the gain of the step; 0.1 with "
        "--preset paper]",
    )
    mu_largest: float | None = option(None, "Value of mu that ends training. [default: 1e10]")
    device: str | None = option(
        None,
        "Device on which torch computes elman or narx networks, all starts together: cpu or cuda. "
        "[default: the compiled kernels, on the processor]",
    )
    at: str = option(
        "output",
        "Place of the correction. output: added to an output of the model; PORT: added to the "
        "value at a port of the rig, as joint or muscle_1 (`pamid rigs RIG` lists them), which "
        "needs the recordings.",
        "--port",
        "--at",
        metavar="output|PORT",
    )
    on: Literal["refit", "causes"] = option(
        "refit",
        "Model of the residual. refit: the refitted model; causes: the model with the causes of a "
        "diagnosis, replayed on recorded commands.",
    )
    rig: RigLike | None = option(
        None, "With --port PORT, for a run with a rig file: its path (it is run)."
    )
    resume: bool = option(False, "Continue the same training where it was interrupted.")
    channel: str | None = option(
        None, "Output to correct. [default: angle_deg, else the first of the run]"
    )
    inputs: Sequence[str] = option(
        (),
        "Columns of residual.csv that are inputs of the network. [default: reference and the model "
        "in closed loop; else inputs of the rig and the model's outputs]",
        metavar="A,B,...",
        separator=",",
    )
    progress: ShowProgress = in_python_only(None, "As in `pamid.fit`.")
    command: Sequence[str] = in_python_only((), "Command that the run notes. Default: this call.")

    @property
    def sizes(self) -> dict[str, int | None]:
        """Sizes of the network; None: by its inputs."""
        return {item.name: getattr(self, item.name) for item in fields(NetworkSizes)}

    @property
    def plain(self) -> bool:
        """Whether the training is that of the first paper."""
        return self.as_in_paper or self.preset == "paper"
