"""diagnosis.json read into frozen nouns (schema pamid.diagnosis/1, section 4 of the contract)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pamid.base.errors import FileError, nearest
from pamid.report.reading import Node, read_object

VERDICTS = ("explained", "ambiguous", "unknown-effect", "no-structural-gap")


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval, in the unit of its name; prior and strain where they are
    told."""

    value: float
    low: float | None
    high: float | None
    prior: float | None = None
    strain: float | None = None


@dataclass(frozen=True)
class Cause:
    """An effect that the verdict adds; share: its Shapley share of the shrinkage among the causes,
    0 to 1."""

    effect: str
    family: str
    port: str
    parameters: dict[str, Estimate]
    share: float | None


@dataclass(frozen=True)
class Candidate:
    """An effect that was refitted; shrinkage (with 95 % interval) is the part of the held-out error
    it removes."""

    effect: str
    family: str
    port: str
    probability: float | None
    # channel -> MAE before, after, in the channel's unit
    held_out: dict[str, tuple[float | None, float | None]]
    shrinkage: float | None
    low: float | None
    high: float | None
    converged: bool
    why: str


@dataclass(frozen=True)
class Regime:
    """A range of a signal with its share of the gap and of the time, 0 to 1; None: open on that
    side."""

    signal: str
    low: float | None
    high: float | None
    unit: str
    share_of_gap: float | None
    share_of_time: float | None


@dataclass(frozen=True)
class Sensor:
    """A further sensor and the groups of ports that it would take apart."""

    name: str
    splits: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Where:
    """The port the gap enters at, all shares (0 to 1), what the sensors cannot tell apart, and when
    it shows."""

    port: str
    shares: tuple[tuple[str, float], ...]
    indistinguishable: tuple[tuple[str, ...], ...]
    regimes: tuple[Regime, ...]
    frequency_hz: tuple[float, float] | None
    windows_s: tuple[tuple[float, float], ...]
    redundancy: float | None
    unseen: tuple[str, ...]
    sensors: tuple[Sensor, ...]


@dataclass(frozen=True)
class Reach:
    """Held-out MAE of a channel by model, in the channel's unit, and the shrinkage with its 95 %
    interval."""

    data_sheet: float | None
    refitted: float | None
    with_cause: float | None
    noise_floor: float | None
    black_box: float | None
    shrinkage: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class NextExperiment:
    """What to measure next, and which effects it would tell apart.

    separation: expected rms difference of their models in noise standard deviations; excitations:
    files to be sent; settings: known values of each repetition.
    """

    name: str
    why: str
    separates: tuple[str, ...]
    separation: float | None
    minutes: float | None
    excitations: tuple[str, ...]
    settings: tuple[dict[str, float], ...]


@dataclass(frozen=True)
class Unknown:
    """A term that no effect explains; inclusion: share of resampled fits in which the formula's
    terms came up; described: share of the term's variance that the formula describes; memory: it
    depends on the past."""

    port: str
    formula: str
    variables: tuple[str, ...]
    inclusion: float | None
    dissipative: bool | None
    parity: str
    memory: bool | None
    described: float | None


@dataclass(frozen=True)
class Pull:
    """A tolerance-sized correction: fitted value over its tolerance, and the share of the gap it
    took, 0 to 1."""

    name: str
    pull: float
    share_of_gap: float | None


@dataclass(frozen=True)
class Transfer:
    """A held-out recording made under other conditions; mae: channel -> refitted, with cause,
    shrinkage."""

    recording: str
    differs: str
    mae: dict[str, tuple[float | None, float | None, float | None]]


@dataclass(frozen=True)
class Diagnosis:
    """diagnosis.json in full."""

    verdict: str
    causes: tuple[Cause, ...]
    ranking: tuple[Candidate, ...]
    where: Where | None
    how_far: dict[str, Reach]
    look_alikes: tuple[tuple[str, ...], ...]
    next_experiment: NextExperiment | None
    parameters: dict[str, Estimate]
    background: tuple[Pull, ...]
    unknown: Unknown | None
    transfer: tuple[Transfer, ...]
    grounds: dict[str, float]
    confidence: dict[str, float]
    remark: str = ""


def read_diagnosis(path: Path) -> Diagnosis | None:
    """The diagnosis in a file; None if there is no such file, FileError where it is damaged."""
    node = read_object(path, "pamid.diagnosis/1")
    if node is None:
        return None
    verdict = node.text("verdict")
    if verdict not in VERDICTS:
        hint = nearest(verdict, VERDICTS) or f"The verdicts are: {', '.join(VERDICTS)}."
        raise FileError(f"{path}: there is no verdict {verdict!r}.", hint, code="damaged")
    where, further, unknown = (
        node.child("where"),
        node.child("next_experiment"),
        node.child("unknown"),
    )
    grounds, confidence = node.child("grounds"), node.child("confidence")
    causes = tuple(_read_cause(one) for one in node.listed("causes"))
    if verdict in ("explained", "ambiguous") and not causes:
        node.refuse("causes", f"a list with at least one effect, as the verdict is {verdict!r}")
    return Diagnosis(
        verdict=verdict,
        causes=causes,
        ranking=tuple(_read_candidate(one) for one in node.listed("ranking")),
        where=None if where is None else _read_where(where),
        how_far={name: _read_reach(one) for name, one in node.children("how_far").items()},
        look_alikes=node.groups("look_alikes"),
        next_experiment=None if further is None else _read_next(further),
        parameters={name: _read_estimate(one) for name, one in node.children("parameters").items()},
        background=tuple(
            Pull(name, one.number("pull"), one.maybe("share_of_gap"))
            for name, one in node.children("background").items()
        ),
        unknown=None if unknown is None else _read_unknown(unknown),
        transfer=tuple(_read_transfer(one) for one in node.listed("transfer")),
        grounds={} if grounds is None else grounds.numbers(),
        confidence={} if confidence is None else confidence.numbers(),
        remark=node.text("remark", ""),
    )


def _read_next(node: Node) -> NextExperiment:
    return NextExperiment(
        node.text("name"),
        node.text("why", ""),
        node.texts("separates"),
        node.maybe("expected_separation"),
        node.maybe("minutes"),
        node.texts("excitations") or tuple(filter(None, [node.text("excitation", "")])),
        tuple(one.numbers() for one in node.listed("settings")),
    )


def _read_unknown(node: Node) -> Unknown:
    return Unknown(
        node.text("port", ""),
        node.text("formula", ""),
        node.texts("variables"),
        node.maybe("inclusion"),
        node.maybe_flag("dissipative"),
        node.text("parity", "none"),
        node.maybe_flag("memory"),
        node.maybe("described"),
    )


def _read_transfer(node: Node) -> Transfer:
    channels = [key for key in node.content if key not in ("recording", "differs")]
    differs = node.child("differs")
    told = (
        []
        if differs is None
        else [f"{key} {_plainly(value)}" for key, value in differs.content.items()]
    )
    return Transfer(
        node.text("recording", ""),
        ", ".join(told),
        {
            name: (one.maybe("mae_refitted"), one.maybe("mae_with_cause"), one.maybe("shrinkage"))
            for name in channels
            if (one := node.child(name)) is not None
        },
    )


def _plainly(value: object) -> str:
    """A value of `differs` as text: a number, a word, or the changed entries of a table."""
    if isinstance(value, dict):
        return " and ".join(f"{key} {_plainly(one)}" for key, one in value.items())
    return (
        f"{value:.3g}"
        if isinstance(value, float | int) and not isinstance(value, bool)
        else str(value)
    )


def _read_cause(node: Node) -> Cause:
    parameters = {name: _read_estimate(one) for name, one in node.children("parameters").items()}
    return Cause(
        node.text("effect"),
        node.text("family", ""),
        node.text("port", ""),
        parameters,
        node.maybe("share"),
    )


def _read_estimate(node: Node) -> Estimate:
    return Estimate(
        node.number("value"),
        node.maybe("low"),
        node.maybe("high"),
        node.maybe("prior"),
        node.maybe("strain"),
    )


def _read_candidate(node: Node) -> Candidate:
    return Candidate(
        effect=node.text("effect"),
        family=node.text("family", ""),
        port=node.text("port", ""),
        probability=node.maybe("probability"),
        held_out={
            name: (one.maybe("mae_before"), one.maybe("mae_after"))
            for name, one in node.children("held_out").items()
        },
        shrinkage=node.maybe("shrinkage"),
        low=node.maybe("low"),
        high=node.maybe("high"),
        converged=node.flag("converged", True),
        why=node.text("why", ""),
    )


def _read_where(node: Node) -> Where:
    return Where(
        port=node.text("port", ""),
        shares=tuple((one.text("port"), one.number("share")) for one in node.listed("ports")),
        indistinguishable=node.groups("indistinguishable"),
        regimes=tuple(_read_regime(one) for one in node.listed("regimes")),
        frequency_hz=node.span("frequency_hz") if node.content.get("frequency_hz") else None,
        windows_s=node.spans("windows_s"),
        redundancy=node.maybe("redundancy"),
        unseen=node.texts("unseen"),
        sensors=tuple(
            Sensor(one.text("sensor"), one.groups("splits")) for one in node.listed("sensors")
        ),
    )


def _read_regime(node: Node) -> Regime:
    return Regime(
        node.text("signal"),
        node.maybe("low"),
        node.maybe("high"),
        node.text("unit", ""),
        node.maybe("share_of_gap"),
        node.maybe("share_of_time"),
    )


def _read_reach(node: Node) -> Reach:
    return Reach(
        data_sheet=node.maybe("mae_data_sheet"),
        refitted=node.maybe("mae_refitted"),
        with_cause=node.maybe("mae_with_cause"),
        noise_floor=node.maybe("noise_floor"),
        black_box=node.maybe("black_box"),
        shrinkage=node.maybe("shrinkage"),
        low=node.maybe("low"),
        high=node.maybe("high"),
    )
