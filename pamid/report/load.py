"""What a run folder holds, read into frozen nouns: the run itself, fit, diagnosis, network,
residual, trace, and the points of a missing term."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pamid.base.errors import FileError
from pamid.base.result_file import REMEDY, damaged, read_result
from pamid.base.run_folder import Run
from pamid.base.units import split_column
from pamid.report.reading import FloatArray, Node, read_columns, read_object
from pamid.schemas.diagnosis import DiagnosisFile

KEYS = ("time_s", "recording", "part", "window")  # columns of residual.csv that are no signal


@dataclass(frozen=True)
class Step:
    """One command that worked on this run, as run.json notes it; times are ISO text or "" if it
    never ended."""

    command: tuple[str, ...]
    seed: float | None
    begun: str
    ended: str
    outcome: str
    versions: tuple[tuple[str, str], ...]
    platform: str
    inputs: tuple[tuple[str, str], ...]  # path, sha256
    rig: str  # as it was named, by name or by file; "" where none was


@dataclass(frozen=True)
class Parameter:
    """A fitted parameter, in `unit`; strain is its distance from the prior in prior standard
    deviations."""

    name: str
    value: float
    low: float | None
    high: float | None
    prior: float | None
    unit: str
    word: str
    at_bound: str
    strain: float | None
    source: str


@dataclass(frozen=True)
class Together:
    """Parameters that are known only in combination, and the combinations that are: as fitted ones,
    without source."""

    parameters: tuple[str, ...]
    known: tuple[Parameter, ...]


@dataclass(frozen=True)
class LoopError:
    """MAE of the model in its own control loop; `band`: its change by 0.1 % of the conductances.
    Channel's unit."""

    channel: str
    data_sheet: float | None
    refitted: float | None
    band: float | None


@dataclass(frozen=True)
class Recorded:
    """A recording that the fit used."""

    name: str
    path: str
    sha256: str
    role: str
    samples: float | None
    period_s: float | None
    loop: str


@dataclass(frozen=True)
class Fit:
    """fit.json. `mae`: channel -> data_sheet, refitted, noise_floor, in the channel's unit."""

    rig: str
    effects: tuple[str, ...]
    recordings: tuple[Recorded, ...]
    channels: tuple[str, ...]
    converged: bool
    why: str
    iterations: float | None
    substeps: float | None
    implicit: bool
    recheck: float | None
    parameters: tuple[Parameter, ...]
    together: tuple[Together, ...]
    background: tuple[tuple[str, float], ...]
    mae: dict[str, dict[str, float]]
    closed_loop: tuple[LoopError, ...]


@dataclass(frozen=True)
class Network:
    """network.json: what was trained, how it ended, and its MAE. `mae`: channel -> refitted,
    with_network.

    in_loop: it corrects the model in its own loop, so its errors do not compare with those of the
    replay.
    """

    kind: str
    n_weights: float | None
    why: str
    converged: bool
    remark: str
    iterations: float | None
    output: str
    mae: dict[str, dict[str, float]]
    in_loop: bool


@dataclass(frozen=True)
class Residual:
    """residual.csv: every column (n,) in the unit of its name."""

    columns: dict[str, FloatArray]

    def of(self, channel: str, kind: str) -> FloatArray | None:
        """A model's trace of a channel; kind: "data_sheet", "refitted", "cause", "network", "loop",
        "loop_network"."""
        stem = split_column(channel)[0]
        return self.columns.get(f"{stem}_{kind}{channel[len(stem) :]}")


@dataclass(frozen=True)
class RunData:
    """All that was found; None for what is not there."""

    steps: tuple[Step, ...]
    fit: Fit | None
    diagnosis: DiagnosisFile | None
    network: Network | None
    residual: Residual | None
    trace: dict[str, FloatArray] | None
    missing: dict[str, FloatArray] | None

    @property
    def rig(self) -> str:
        """The rig's name, "" if no file says it."""
        if self.fit is not None:
            return self.fit.rig
        return self.named_rig

    @property
    def named_rig(self) -> str:
        """The rig as it was named to the command, by name or by file; else as the fit names it."""
        first = self.steps[0]
        return (
            first.rig
            or _option(first.command, "--rig")
            or (self.fit.rig if self.fit is not None else "")
        )

    def recording_words(self, number: int) -> str:
        """ " in recording NAME" where there are several of them, else ""; `number` as in
        residual.csv."""
        known = self.fit.recordings if self.fit is not None else ()
        return (
            f" in recording {known[number].name}"
            if len(known) > 1 and 0 <= number < len(known)
            else ""
        )


def load_run(folder: Path) -> RunData:
    """Read a run folder; FileError if it is none, holds no result, or one of its files is
    damaged."""
    Run.open(folder)
    fit, diagnosis = (
        read_object(folder / "fit.json", "pamid.fit/1"),
        read_diagnosis(folder / "diagnosis.json"),
    )
    if fit is None and diagnosis is None:
        hint = "`pamid fit` or `pamid diagnose` with --output writes one."
        raise FileError(
            f"{folder} holds no result yet: neither fit.json nor diagnosis.json.",
            hint,
            code="no-result",
        )
    network, residual = read_object(folder / "network.json"), read_columns(folder / "residual.csv")
    if residual is not None:
        _require(folder / "residual.csv", residual, KEYS)
    trace = read_columns(folder / "trace.csv")
    if trace is not None:
        _require(folder / "trace.csv", trace, ("iteration", "mse"))
    missing = read_columns(folder / "missing.csv")
    if missing is not None:
        _require(
            folder / "missing.csv",
            {split_column(name)[0]: x for name, x in missing.items()},
            ("missing",),
        )
    trained = None if network is None else _read_network(network)
    # its trace belongs to another comparison
    if residual is not None and trained is not None and trained.in_loop:
        residual = {
            name.replace("_network", "_loop_network"): values for name, values in residual.items()
        }
    return RunData(
        steps=read_steps(folder / "run.json"),
        fit=None if fit is None else _read_fit(fit),
        diagnosis=diagnosis,
        network=trained,
        residual=None if residual is None else Residual(residual),
        trace=trace,
        missing=missing,
    )


def read_diagnosis(path: Path) -> DiagnosisFile | None:
    """The diagnosis in a file; None if there is no such file, FileError where it is damaged."""
    found = read_result(path, DiagnosisFile)
    if found is not None and found.verdict in ("explained", "ambiguous") and not found.causes:
        needed = f"a list with at least one effect, as the verdict is {found.verdict!r}"
        raise damaged(path, "causes", needed, "empty")
    return found


def read_steps(path: Path) -> tuple[Step, ...]:
    """The commands that run.json notes."""
    record = read_object(path)
    assert record is not None
    return tuple(_read_step(node) for node in (record, *record.listed("steps")))


def _read_step(node: Node) -> Step:
    versions, options = node.child("versions"), node.child("options")
    return Step(
        command=node.texts("command"),
        seed=node.maybe("seed"),
        begun=node.text("begun", ""),
        ended=node.text("ended", ""),
        outcome=node.text("outcome", ""),
        versions=()
        if versions is None
        else tuple((name, versions.text(name)) for name in versions.content),
        platform=node.text("platform", ""),
        inputs=tuple((one.text("path"), one.text("sha256")) for one in node.listed("inputs")),
        rig="" if options is None else options.text("rig", ""),
    )


def _read_fit(node: Node) -> Fit:
    stepping = node.child("stepping") or Node(node.file, "stepping", {})
    combinations = {
        name: _read_parameter(name, one) for name, one in node.children("combinations").items()
    }
    return Fit(
        rig=node.text("rig"),
        effects=node.texts("effects"),
        recordings=tuple(_read_recorded(one) for one in node.listed("recordings")),
        channels=node.texts("channels"),
        converged=node.flag("converged", True),
        why=node.text("why", ""),
        iterations=node.maybe("iterations"),
        substeps=stepping.maybe("substeps"),
        implicit=stepping.flag("implicit", False),
        recheck=stepping.maybe("recheck"),
        parameters=tuple(
            _read_parameter(name, one) for name, one in node.children("parameters").items()
        ),
        together=tuple(
            Together(
                one.texts("parameters"),
                tuple(combinations[name] for name in one.texts("known") if name in combinations),
            )
            for one in node.listed("tied")
        ),
        background=tuple(
            (name, one.number("pull")) for name, one in node.children("background").items()
        ),
        mae={name: one.numbers() for name, one in node.children("mae").items()},
        closed_loop=tuple(
            LoopError(name, one.maybe("data_sheet"), one.maybe("refitted"), one.maybe("band"))
            for name, one in node.children("closed_loop").items()
        ),
    )


def _read_recorded(node: Node) -> Recorded:
    return Recorded(
        node.text("name"),
        node.text("path", ""),
        node.text("sha256", ""),
        node.text("role", ""),
        node.maybe("samples"),
        node.maybe("period_s"),
        node.text("loop", ""),
    )


def _read_parameter(name: str, node: Node) -> Parameter:
    return Parameter(
        name=name,
        value=node.number("value"),
        low=node.maybe("low"),
        high=node.maybe("high"),
        prior=node.maybe("prior"),
        unit=node.text("unit", split_column(name)[1]),
        word=node.text("word", ""),
        at_bound=node.text("at_bound", ""),
        strain=node.maybe("strain"),
        source=node.text("source", ""),
    )


def _read_network(node: Node) -> Network:
    training = node.child("training") or Node(node.file, "training", {})
    output = node.child("output") or Node(node.file, "output", {})
    return Network(
        kind=node.text("kind", "network"),
        n_weights=node.maybe("n_weights"),
        why=training.text("why", ""),
        converged=training.flag("converged", True),
        remark=training.text("remark", ""),
        iterations=training.maybe("iterations"),
        output=output.text("name", ""),
        mae={name: one.numbers() for name, one in node.children("mae").items()},
        in_loop=node.text("model", "replay") == "loop",
    )


def _require(path: Path, columns: dict[str, FloatArray], needed: tuple[str, ...]) -> None:
    missing = [name for name in needed if name not in columns]
    if missing:
        raise FileError(f"{path} lacks the column {missing[0]!r}.", REMEDY, code="damaged")


def _option(command: tuple[str, ...], name: str) -> str:
    words = " ".join(command).split() if len(command) == 1 else list(command)
    for word, following in zip(words, words[1:], strict=False):
        if word == name:
            return following
    return ""
