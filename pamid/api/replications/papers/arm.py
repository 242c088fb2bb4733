"""`pamid reproduce-paper --paper arm`: the second paper's validation of an arm of two links:
gravity tests without actuation and pulses on the valves that no fit has seen, for the data sheet
and for models fitted in stages, with the analytic force law of the muscles and with an ANFIS
trained on a measured force map; what is known of the inertial data, and what is not.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from pamid.api.force_laws import write_law
from pamid.api.replications.arm_coupling import Uncoupled, coupling_json, coupling_png
from pamid.api.replications.arm_twin import (
    ARM_RIG,
    DRY_FRICTION,
    GRAVITY_TEST,
    PULSES,
    VARIABLES,
    WITH_PAYLOAD,
    ArmRecords,
    ArmTwin,
    record_arm,
    sessions,
    shown,
    shown_mae,
    unit_of,
)
from pamid.api.replications.reproducing import number_cell
from pamid.base.arrays import Array
from pamid.base.errors import ConvergenceError
from pamid.base.files import write_atomically
from pamid.base.json_file import write_json
from pamid.base.progress import Progress, silent
from pamid.base.run_folder import FIT_FILE, Run
from pamid.base.schemas import paper_files as result
from pamid.estimation.fit_files import fit_json
from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.estimation.posterior import EarlierPosterior, read_posterior
from pamid.estimation.quantities import declared
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.registry import catalogue_rig, effects
from pamid.networks.correction.force_map import judge, read_map
from pamid.networks.correction.trained_force_law import force_law_of
from pamid.recording.recording import Recording
from pamid.report.paper_figure import Panel, arm_picture
from pamid.rigs.muscle import Law
from pamid.rigs.two_link import MUSCLES, TwoLink
from pamid.simulation.data_split import DataSplit
from pamid.simulation.free_runs import free_run
from pamid.simulation.replay import Replay
from pamid.simulation.rig_data import data_of
from pamid.simulation.tracks import track_of
from pamid.simulation.windows import Runner

# procedure: Dynamic characterization and simulation of two-link soft robot arm with pneumatic
# muscles, Mechanism and Machine Theory (2016)
ARM_TABLE_FILE, MAP_FILE = "arm-paper.json", "muscle-map.csv"
ARM_FIGURES = {GRAVITY_TEST: "figures/gravity.png", PULSES: "figures/pulses.png"}
COUPLING_FIGURE = "figures/coupling.png"
UNLOADED, WITHOUT_DRY = "without_payload", "without_dry_friction"
DATA_SHEET, NOISE_FLOOR = "data_sheet", "noise_floor"
ANALYTIC_ALONE, ANFIS_ALONE, ANALYTIC, ANFIS = (
    "analytic_alone",
    "anfis_alone",
    "fitted_analytic",
    "fitted_anfis",
)
FITTED = (ANALYTIC_ALONE, ANFIS_ALONE, ANALYTIC, ANFIS)
# of the ANFIS, per input: three bend between as few contractions as the map has
SETS = 2
# by which share of the noise floor a fitted angle may lie above it in the gravity test
AT_THE_FLOOR = 0.05
QUICK_ARM_S, QUICK_MUSCLES, QUICK_PERIOD_S = 4.0, ("12", "21"), 0.006

ARM_NOTES = (
    "A virtual arm, not the authors' arm: their recordings and parameters are not published, so "
    "their figures are not compared with these. The hidden values of the twin are our choice. Its "
    "equations are those of the model, except the force law and the dry friction of its joints.",
    "Dry friction is not in the rig: it is added as coulomb-friction at both joints, to every "
    "fit but the one without dry friction. The data sheet has none.",
    "Free runs begin at the start of the recording, without any reset. A clamped joint and its "
    "muscles are not scored. The noise floor is the error of the twin itself.",
    "With corrections: force maps (3 %) and valves (5 %) of every muscle may depart smoothly from "
    "the law, as in every "
    "fit of pamid. They can compensate errors of the analytic law; the law alone "
    "has no corrections.",
    "A swing determines inertias, first moments and friction only up to a common factor. The test "
    "with a known payload determines this factor, as a known torque would. The motion does not "
    "determine single masses, centres and inertias.",
    "scale multiplies a force law: the true value is that of the twin's law. The ANFIS has learnt "
    "this factor from the map, so its true scale is 1. For slack muscles the ANFIS was trained on "
    "the law of the catalogue that is closest to the map.",
)


@dataclass(frozen=True)
class ArmPlan:
    """swing_s: length of each gravity test; muscles: those that are pulsed; quick: too little to be
    believed."""

    swing_s: float = 10.0
    muscles: tuple[str, ...] = MUSCLES
    period_s: float = 0.003
    seed: int = 0
    quick: bool = False


class LawAlone(TwoLink):
    """The arm without room for tolerances: its muscles pull as the law says, up to `scale`."""

    name = ARM_RIG
    background = {}


@dataclass(frozen=True, eq=False)
class ArmModel:
    """A fit's model with parameters p (SI); found: its fit.json, where these are the fitted."""

    grey: GreyBox
    p: Array
    found: dict[str, Any] = field(default_factory=dict)

    def free(self, r: Recording) -> Array:
        """A run over a whole recording from the state in which the rig begins (samples x VARIABLES,
        SI)."""
        a, stepping = self.grey.assembly, self.grey.fit.stepping
        t = track_of(a, data_of(a.rig, r), VARIABLES)
        run = free_run(
            a, t.u, Runner(a, t, stepping).parameters(self.p), t.period_s, stepping=stepping
        )
        if run.blown_up >= 0:
            raise ConvergenceError(
                f"{r.path}: the model became unstable at {run.blown_up * t.period_s:.3f} s."
            )
        return run.outputs

    def free_mae(self, recordings: Iterable[Recording]) -> dict[str, float]:
        """Errors of free runs, as `shown_mae`."""
        return shown_mae(
            (r, data_of(self.grey.assembly.rig, r).outputs(VARIABLES) - self.free(r))
            for r in recordings
        )


# ---- fits --------------------------------------------------------------------------------------


def fit_stages(
    run: Run, records: ArmRecords, plan: ArmPlan, progress: Progress
) -> tuple[dict[str, ArmModel], dict[str, Any]]:
    """All fits, each in a separate run folder as `pamid fit --from` would leave it;
    force-law.json of the map."""

    def stage(
        name: str,
        evidence: DataSplit,
        earlier: EarlierPosterior | None = None,
        dry: tuple[str, ...] = DRY_FRICTION,
    ) -> ArmModel:
        grey = fit_model(
            evidence,
            tuple(attach(evidence.rig, label, effects()) for label in dry),
            seed=plan.seed,
            progress=lambda text: progress(f"{name}: {text}"),
            earlier=earlier,
        )
        fitted = ArmModel(grey, grey.fit.p, fit_json(grey, plan.seed))
        folder = part(run, name, plan, [r.path for r in evidence.recordings])
        write_json(folder.path(FIT_FILE), fitted.found)
        folder.finish()
        return fitted

    def pulsed(name: str, rig: TwoLink, law: Law | None = None) -> ArmModel:
        rig.static_force = law or rig.static_force
        return stage(name, records.evidence(rig, PULSES), known)

    stages = {
        UNLOADED: stage(
            "gravity-without-payload", records.evidence(TwoLink(), GRAVITY_TEST, WITH_PAYLOAD)
        ),
        WITHOUT_DRY: stage(
            "gravity-without-dry-friction", records.evidence(TwoLink(), GRAVITY_TEST), dry=()
        ),
        GRAVITY_TEST: stage("gravity", records.evidence(TwoLink(), GRAVITY_TEST)),
    }
    known = read_posterior(run.folder / "gravity")
    progress("force map of a muscle")
    judged = judge(read_map(run.path(MAP_FILE)), sets=SETS, seed=plan.seed)
    folder = part(run, "law", plan, [run.path(MAP_FILE)])
    about = write_law(folder, judged, ARM_RIG, True).as_json()
    folder.finish()
    measured = force_law_of(judged.trained)
    return {
        **stages,
        ANALYTIC_ALONE: pulsed("pulses-analytic-alone", LawAlone()),
        ANFIS_ALONE: pulsed("pulses-anfis-alone", LawAlone(), measured),
        ANALYTIC: pulsed("pulses-analytic", TwoLink()),
        ANFIS: pulsed("pulses-anfis", TwoLink(), measured),
    }, about


def part(run: Run, name: str, plan: ArmPlan, inputs: list[Any]) -> Run:
    """A run folder within this run."""
    command = run.record["command"]
    return Run.create(
        run.path(name), command=command, seed=plan.seed, inputs=inputs, overwrite=True
    )


def models_of(stages: dict[str, ArmModel]) -> dict[str, ArmModel]:
    """By column of the table. The data sheet goes with the analytic law."""
    grey = stages[ANALYTIC].grey
    sheet = ArmModel(grey, grey.assembly.data_sheet())
    return {DATA_SHEET: sheet, **{name: stages[name] for name in FITTED}}


def free_json(stages: dict[str, ArmModel], records: ArmRecords) -> dict[str, Any]:
    """By kind of test and variable: the errors of all models in free runs, and the noise floor."""
    models, errors = models_of(stages), {}
    swinging = {**models, WITHOUT_DRY: stages[WITHOUT_DRY]}
    for kind, chosen in ((GRAVITY_TEST, swinging), (PULSES, models)):
        recordings = records.of(kind, held_out=True)
        by = {name: model.free_mae(recordings) for name, model in chosen.items()}
        errors[kind] = _by_variable({**by, NOISE_FLOOR: records.floor(kind)})
    return errors


def windowed_json(stages: dict[str, ArmModel]) -> dict[str, Any]:
    """The same as the fits themselves judge, in short windows whose states are set anew. The
    gravity tests were fitted with the analytic law alone of the two."""
    errors = {}
    for kind, names in ((GRAVITY_TEST, {ANALYTIC: GRAVITY_TEST}), (PULSES, dict.fromkeys(FITTED))):
        greys = {name: stages[stage or name].grey for name, stage in names.items()}
        by = {name: windowed_mae(g.evidence, g.held_out) for name, g in greys.items()}
        plain = greys[ANALYTIC]
        errors[kind] = _by_variable(
            {
                DATA_SHEET: windowed_mae(plain.evidence, plain.data_sheet),
                **by,
                NOISE_FLOOR: windowed_mae(plain.evidence, plain.floor),
            }
        )
    return errors


def windowed_mae(evidence: DataSplit, replays: tuple[Replay, ...]) -> dict[str, float]:
    """Errors of what a fit has replayed of its held-out recordings, as `shown_mae`."""
    return shown_mae(
        (span.recording, replay.residual[replay.scored])
        for span, replay in zip(evidence.held_out, replays, strict=True)
    )


def _by_variable(by: dict[str, dict[str, float]]) -> dict[str, Any]:
    return {
        v: {"unit": unit_of(v), **{name: cells[v] for name, cells in by.items()}} for v in VARIABLES
    }


def target_of(mae: dict[str, Any]) -> result.ArmTarget:
    """Do the fitted angles of the gravity test lie at the noise floor?"""
    angles = {v: cells for v, cells in mae[GRAVITY_TEST].items() if cells["unit"] == "deg"}
    most = 1.0 + AT_THE_FLOOR
    over = {
        name: {v: cells[name] / cells[NOISE_FLOOR] for v, cells in angles.items()}
        for name in (ANALYTIC, ANFIS)
    }
    worst = max(ratio for by in over.values() for ratio in by.values())
    return result.ArmTarget(
        share=AT_THE_FLOOR, error_over_floor=over, worst=worst, reached=worst <= most
    )


def combinations_json(stages: dict[str, ArmModel], twin: ArmTwin) -> dict[str, Any]:
    """Inertial combinations by stage."""
    plain = Assembly(catalogue_rig(ARM_RIG))
    truth = plain.values(twin.hidden())
    truths = {name: of(truth) for name, of in declared(plain).items()}
    return _by_stage(stages, "combinations", truths, truths)


def parameters_json(stages: dict[str, ArmModel], twin: ArmTwin) -> dict[str, Any]:
    """Fitted parameters by stage."""
    parameters = stages[GRAVITY_TEST].found["parameters"]
    return _by_stage(stages, "parameters", parameters, {**twin.hidden(), **twin.friction})


def _by_stage(
    stages: dict[str, ArmModel], table: str, names: Iterable[str], truths: dict[str, float]
) -> dict[str, Any]:
    """Estimates of a table of fit.json by stage; holds (none of a scale): does the interval hold
    the truth? What has no truth here is as the data sheet says."""
    tables = {name: s.found[table] for name, s in stages.items() if name != WITHOUT_DRY}
    rows = {}
    for name in names:
        estimate = tables[GRAVITY_TEST][name]
        sheet = estimate["prior"] if estimate.get("null") is None else estimate["null"]
        truth = truths.get(name, estimate["prior"])
        rows[name] = {"unit": estimate["unit"], DATA_SHEET: sheet, "truth": truth}
        for stage, of_stage in tables.items():
            e = of_stage[name]
            rows[name][stage] = {key: e[key] for key in ("value", "low", "high", "word")}
            holds = None if name == "scale" else e["low"] <= truth <= e["high"]
            rows[name][stage]["holds"] = holds
    return rows


def ties_of(fit: dict[str, Any]) -> tuple[result.ArmTie, ...]:
    """Parameters that a stage knows only in combination, and what it knows of them."""
    values = {name: table["value"] for name, table in fit["combinations"].items()}
    return tuple(
        result.ArmTie(
            parameters=tie["parameters"], known={name: values[name] for name in tie["known"]}
        )
        for tie in fit["tied"]
    )


# ---- everything --------------------------------------------------------------------------------


def reproduce(run: Run, plan: ArmPlan, *, progress: Progress = silent) -> dict[str, Any]:
    """Everything into a run folder; returns pamid.paper-arm/1, which is in arm-paper.json, too."""
    twin = ArmTwin()
    run.path(ARM_TABLE_FILE).unlink(missing_ok=True)  # of an earlier run
    progress("recording the twin")
    planned = sessions(plan.swing_s, plan.muscles, plan.period_s)
    run.claim(*(f"{session.name}{suffix}" for session in planned for suffix in (".csv", ".toml")))
    records = record_arm(run.folder, twin, planned, plan.seed)
    twin.force_map(run.path(MAP_FILE), [plan.seed, 1])
    stages, law = fit_stages(run, records, plan, progress)
    progress("free runs")
    mae = free_json(stages, records)
    coupling, swings = coupling_json(
        records.taken_of(PULSES, held_out=True)[0], coupling_runs(stages, records)
    )
    content = result.ArmPaperFile(
        quick=plan.quick,
        plan=result.ArmPlanUsed(**asdict(plan)),
        notes=ARM_NOTES,
        twin=result.ArmTwinUsed(law=twin.law, hidden={**twin.hidden(), **twin.friction}),
        recordings=tuple(
            result.ArmRecording(
                name=t.session.name,
                kind=t.session.kind,
                held_out=t.session.held_out,
                known=t.session.known,
                samples=len(t.recording),
            )
            for t in records.taken
        ),
        force_law=result.ArmForceLaw(
            **{key: law[key] for key in ("finding", "advice", "anfis", "laws")}
        ),
        mae=mae,
        windowed_mae=windowed_json(stages),
        target=target_of(mae),
        coupling=coupling,
        combinations=combinations_json(stages, twin),
        parameters=parameters_json(stages, twin),
        tied={name: ties_of(s.found) for name, s in stages.items()},
        fits={
            name: result.StageEnd(converged=s.found["converged"], why=s.found["why"])
            for name, s in stages.items()
        },
    ).as_json()
    write_json(run.path(ARM_TABLE_FILE), content)
    for kind, file in ARM_FIGURES.items():
        write_atomically(run.path(file), picture_of(stages, records, kind, mae[kind]))
    write_atomically(run.path(COUPLING_FIGURE), coupling_png(coupling, swings))
    return content


def coupling_runs(stages: dict[str, ArmModel], records: ArmRecords) -> dict[str, Array]:
    """Free runs over the first held-out pulses, for `coupling_json`: fitted with the ANFIS, with
    and without the coupling terms."""
    r, models = records.of(PULSES, held_out=True)[0], models_of(stages)
    fitted, apart = models[ANFIS], Uncoupled()
    apart.static_force = stages[ANFIS].grey.assembly.rig.static_force  # type: ignore[attr-defined]
    grey = replace(fitted.grey, assembly=replace(fitted.grey.assembly, rig=apart))
    return {
        "data_sheet": models[DATA_SHEET].free(r),
        "fitted": fitted.free(r),
        "without_coupling": ArmModel(grey, fitted.p).free(r),
    }


def picture_of(
    stages: dict[str, ArmModel], records: ArmRecords, kind: str, mae: dict[str, Any]
) -> bytes:
    """PNG of the first held-out recording of a kind: measured, data sheet, with the ANFIS."""
    r, models = records.of(kind, held_out=True)[0], models_of(stages)
    sheet, fitted = models[DATA_SHEET].free(r), models[ANFIS].free(r)
    panels = []
    for k, v in enumerate(VARIABLES):
        word, joint, *_ = v.split("_")
        traces = {"measured": r.si(v), "data sheet": sheet[:, k], "fitted, ANFIS law": fitted[:, k]}
        lines = {name: shown(v, y) for name, y in traces.items()}
        panels.append(Panel(f"{word} {joint} [{unit_of(v)}]", r.time, lines))
    angles = [cells for cells in mae.values() if cells["unit"] == "deg"]
    off = {
        name: " and ".join(f"{cells[name]:.2g}" for cells in angles)
        for name in (DATA_SHEET, ANFIS, NOISE_FLOOR)
    }
    title = (
        f"{'Gravity test' if kind == GRAVITY_TEST else 'Valve pulses'} that no fit has seen: "
        f"fitted, the angles are off by {off[ANFIS]} deg (noise alone: {off[NOISE_FLOOR]}), "
        f"by the data sheet {off[DATA_SHEET]} deg"
    )
    return arm_picture(kind, title, panels)


OPTIONS = ()
#: columns of the tables: key, heading
_MODELS = {
    DATA_SHEET: "data sheet",
    WITHOUT_DRY: "no dry fr.",
    ANALYTIC_ALONE: "analytic",
    ANFIS_ALONE: "ANFIS",
    ANALYTIC: "analytic",
    ANFIS: "ANFIS",
    NOISE_FLOOR: "noise",
}
_TITLES = {GRAVITY_TEST: "Gravity tests", PULSES: "Valve pulses"}


def plan(*, seed: int, quick: bool) -> ArmPlan:
    """quick: short swings and two muscles, coarsely sampled, to see it work."""
    if quick:
        return ArmPlan(QUICK_ARM_S, QUICK_MUSCLES, QUICK_PERIOD_S, seed, True)
    return ArmPlan(seed=seed)


def converged(paper: dict[str, Any]) -> bool:
    """Did every fit?"""
    return all(fit["converged"] for fit in paper["fits"].values())


def text(paper: dict[str, Any]) -> str:
    """The errors of all variables, what is known of the inertial data and of the rest, and what all
    of it is not."""
    lines = (
        [
            "QUICK: short swings and two muscles are too little; these figures only show that it "
            "runs.",
            "",
        ]
        if paper["quick"]
        else []
    )
    lines += [
        "The second paper's validation on a virtual arm, not the authors' arm.",
        "Mean absolute errors of recordings that no fit has seen:",
        "",
        f"{'':46s}{'law alone':>22s}{'with corrections':>22s}",
    ]
    for kind, title in _TITLES.items():
        lines += _errors(f"{title}, free runs", paper["mae"][kind].items())
    lines.append("Angles again, in windows whose states are set anew, as `pamid fit` judges them")
    for kind, title in _TITLES.items():
        lines += _errors(
            title,
            [item for item in paper["windowed_mae"][kind].items() if item[1]["unit"] == "deg"],
        )
    words = ("moves by", "data sheet", "uncoupled", "fitted", "noise")
    names = ("data_sheet", "without_coupling", "fitted", "noise_floor")
    lines += [
        "Coupling: the angle of a joint while only the other joint's valves are pulsed, deg",
        f"{'joint':24s}" + "".join(f"{word:>11s}" for word in words),
        *(
            f"{estimate['moved'].rsplit('_', 1)[0]:24s}{estimate['swing_deg']:11.3f}"
            + "".join(number_cell(estimate["mae"].get(name), 11) for name in names)
            for estimate in paper["coupling"]
        ),
        "",
    ]
    target, in_the_end = paper["target"], paper["tied"]["fitted_anfis"]
    still = {name for tie in in_the_end for name in tie["parameters"]}
    unloaded = [tie for tie in paper["tied"][UNLOADED] if still & set(tie["parameters"])]
    lines += [
        f"Target     fitted angles of the gravity tests within {100.0 * target['share']:.0f} % of "
        f"the noise: {'reached' if target['reached'] else 'NOT reached'} (at most "
        f"{target['worst']:.3f} times)",
        f"Force law  {paper['force_law']['finding']}",
        "",
        # with and without the test that sets the common factor
        *_estimates(
            "Inertial data",
            paper["combinations"],
            {UNLOADED: "without the payload test", GRAVITY_TEST: "all gravity tests"},
        ),
        *_tied("Known only in combination", in_the_end),
        *_tied("Without the payload test", unloaded),
        "",
        *_estimates(
            "Parameter",
            paper["parameters"],
            {ANALYTIC: "fitted, analytic law", ANFIS: "fitted, ANFIS law"},
        ),
        "* the interval does not hold the truth",
        "",
    ]
    lines += [
        f"Not converged: {name}: {fit['why']}"
        for name, fit in paper["fits"].items()
        if not fit["converged"]
    ]
    return "\n".join(
        [
            *lines,
            f"Hidden     muscles: {paper['twin']['law']}; the rest as in the column truth",
            *(f"Note       {note}" for note in paper["notes"]),
        ]
    )


def _errors(title: str, variables: Iterable[tuple[str, dict[str, Any]]]) -> list[str]:
    return [
        f"{title:24s}" + "".join(f"{word:>11s}" for word in _MODELS.values()),
        *(
            f"{name.rsplit('_', 1)[0] if name.endswith(('_deg', '_kpa')) else name:18s}{cells['unit']:6s}"  # noqa: E501
            + "".join(number_cell(cells.get(key), 11) for key in _MODELS)
            for name, cells in variables
        ),
        "",
    ]


def _estimates(title: str, estimates: dict[str, Any], stages: dict[str, str]) -> list[str]:
    """Estimates by two stages of the fits, next to the data sheet and the truth."""
    return [
        f"{title:28s}{'data sheet':>11s}{'truth':>11s}"
        + "".join(f"{heading:>38s}" for heading in stages.values()),
        *(
            f"{name:28s}{estimate['data_sheet']:11.4g}{estimate['truth']:11.4g}"
            + "".join(_estimate_cell(estimate[stage]) for stage in stages)
            for name, estimate in estimates.items()
        ),
    ]


def _estimate_cell(table: dict[str, Any]) -> str:
    """Value and 95 % interval."""
    text = f"{table['value']:.4g} ({table['low']:.4g} .. {table['high']:.4g})"
    return f"{text:>37s}{'*' if table['holds'] is False else ' '}"


def _tied(title: str, ties: list[dict[str, Any]]) -> list[str]:
    """Parameters that are known only in combination, and the combinations."""
    return [
        f"{title}: {', '.join(tie['parameters'])} through "
        + ", ".join(f"{name} = {value:.4g}" for name, value in tie["known"].items())
        for tie in ties
    ]
