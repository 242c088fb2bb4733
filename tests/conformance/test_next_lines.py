"""Every line that a command prints to be copied runs: taken from what the command really prints,
and run as it stands.

A diagnosis of the joint takes half a minute; where it is not what is asked for, it counts as run
once it has taken its recordings (`taken`). The slow tests run them to their end.
"""

import re
import shlex
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pamid_cli import frame
from pamid_cli.demo import demo_text
from small_cart import others, record_cart

import pamid.api.trial_cases as trial_work
from pamid.api.authoring.column_match import examples
from pamid.base.errors import PamidError
from pamid.base.schemas.diagnosis_file import NextExperiment
from pamid.diagnosis.planning import next_experiment
from pamid.diagnosis.planning.experiment_ways import NEXT_FILES
from pamid.diagnosis.planning.next_experiment import Proposal, bench_of, sent_with
from pamid.model.registry import rig_named
from pamid.recording.recording import Recording, read_recording
from pamid.report.answers import answers_of
from pamid.report.channel_errors import errors_of
from pamid.report.load import load_run
from pamid.rigs.muscle_experiments import EXPERIMENTS
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.simulation.excitation.experiments import MENU, Experiment, menu

ROOT = Path(__file__).resolve().parents[2]
TAKEN = 77
SIGNALS = ("aprbs", "prbs", "multisine", "chirp", "steps", "staircase", "torque-loops")
LASTING = ("aprbs", "prbs", "multisine", "chirp", "steps", "torque-loops")
RIGS = ("one-dof", "two-link", "cart.py")
EXAMPLES = sorted(examples())
MULTISINE = ("--band", "0.2", "5")

Run = Callable[..., str]


def offered() -> list[tuple[str, ...]]:
    """Every signal and experiment of `pamid generate-aprbs` that these rigs have, as its
    options."""
    found: list[tuple[str, ...]] = []
    for rig in RIGS:
        for signal in SIGNALS:
            last = ("--duration", "12") if signal in LASTING else ()
            told = ("--rig", rig, "--signal", signal, *last)
            told += MULTISINE if signal == "multisine" else ()
            if rig == "cart.py":
                found += [(*told, "--amplitude", "2")] if signal != "torque-loops" else []
            elif signal == "torque-loops":
                found += [told, (*told, "--pressure", "300")]
            else:
                found += [told, (*told, "--loop", "open")]
    found += [
        ("--rig", rig, "--experiment", "valve-pulses", "--muscle", m)
        for rig, m in (("one-dof", "2"), ("two-link", "11"))
    ]
    fallen = ("--rig", "two-link", "--experiment", "gravity-test", "--duration", "6")
    return [*found, fallen, (*fallen, "--clamped", "1", "--release", "0", "30")]


def sampled(
    every: list[Any], quick: Callable[[Any], bool], name: Callable[[Any], str]
) -> list[Any]:
    """Parameters of a walk; what is not of the quick sample is left to the slow tests."""
    return [
        pytest.param(
            *(one if isinstance(one[1], Experiment) else (one,)),
            id=name(one),
            marks=() if quick(one) else pytest.mark.slow,
        )
        for one in every
    ]


# ---- how a line is found and run --------------------


def lines_of(text: str, word: str = "Next: ") -> list[list[str]]:
    """The commands of the lines that begin with this word: arguments of `pamid`, remarks in
    brackets left out."""
    (line,) = [one.removeprefix(word) for one in text.splitlines() if one.startswith(word)]
    said = [re.sub(r"   \(.*", "", part) for part in line.split("   or   ")]
    found = [shlex.split(part[part.index("pamid ") :]) for part in said if "pamid " in part]
    return [words[1:] for words in found]


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """An empty working folder, but for the cart."""
    shutil.copy(ROOT / "data" / "rigs" / "cart.py", tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def run(capsys) -> Run:
    """Run `pamid` with these arguments; what it prints. It has to come to a good end."""

    def command(*words, code=0):
        capsys.readouterr()
        assert frame.run(list(words)) == code, (words, capsys.readouterr())
        return capsys.readouterr().out

    return command


@pytest.fixture
def taken(monkeypatch) -> Iterator[list[DataSplit]]:
    """Let `pamid diagnose` end with exit code `TAKEN` once it has taken its recordings; what it
    took."""
    found: list[DataSplit] = []

    def begun(run, evidence, *_, **__):
        found.append(evidence)
        raise PamidError("taken", exit_code=TAKEN)

    monkeypatch.setattr("pamid.api.diagnosing.diagnose_into", begun)
    yield found


def free(words: list[str]) -> list[str]:
    """The arguments, which write nothing that is there already."""
    output = Path(words[words.index("--output") + 1])
    assert not output.exists()
    return words


# ---- excitations --------------------


#: of the signals and experiments; torque loops are walked as a recommended experiment
QUICK = (
    ("cart.py", "aprbs"),
    ("cart.py", "chirp"),
    ("one-dof", "aprbs"),
    ("one-dof", "valve-pulses"),
    ("two-link", "gravity-test"),
)


def quick(options: tuple[str, ...]) -> bool:
    more = {"--pressure", "--clamped"} & set(options)
    return not more and (options[1], options[3]) in QUICK


@pytest.mark.parametrize("options", sampled(offered(), quick, " ".join))
def test_what_is_generated_is_simulated_checked_and_taken(options, here, run, taken):
    (simulate,) = lines_of(run("generate-aprbs", *options, "--output", "sent.csv"))
    (diagnose,) = lines_of(run(*free(simulate)))
    rig = options[1]
    assert diagnose[diagnose.index("--rig") + 1] == rig
    run("check", "rec.csv", "--rig", rig)
    run(*free(diagnose), code=TAKEN)
    (evidence,) = taken
    assert len(evidence.recordings) == 1 and evidence.channels


@pytest.mark.parametrize(
    "rig",
    sampled(
        [name for name in EXAMPLES if rig_named(name).inputs],
        lambda name: name in ("dc-motor", "thermal-block", "two-masses"),
        str,
    ),
)
def test_a_rig_to_start_from_is_excited_copied_and_taken(rig, here, run, taken):
    last = str(20.0 * rig_named(rig).hold_s[1])
    (simulate,) = lines_of(
        run("generate-aprbs", "--rig", rig, "--duration", last, "--output", "sent.csv")
    )
    (diagnose,) = lines_of(run(*free(simulate)))
    run(*free(diagnose), code=TAKEN)
    for check in lines_of(run("new-rig", "rec.csv", "--output", "mine.py")):
        run(*check)
    run("diagnose", "rec.csv", "--rig", "mine.py", "--output", "own", code=TAKEN)
    assert len(taken) == 2


def test_names_that_are_taken_are_not_suggested(here, run, taken):
    (here / "run").mkdir()
    options = ("generate-aprbs", "--duration", "6", "--output")
    (simulate,) = lines_of(run(*options, "rec.csv"))
    assert simulate[-1] == "rec-2.csv"
    (diagnose,) = lines_of(run(*simulate))
    assert diagnose[-1] == "run-2"
    run(*diagnose, code=TAKEN)
    (again,) = lines_of(run(*options, "other.csv"))
    assert again[-1] == "rec-3.csv"


# ---- the experiments that a diagnosis recommends --------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> dict[str, Recording]:
    """A recording of each rig, as it would be diagnosed first."""
    folder, found = tmp_path_factory.mktemp("recorded"), {}
    shutil.copy(ROOT / "data" / "rigs" / "cart.py", folder)
    for rig, more in (("one-dof", ()), ("two-link", ()), ("cart.py", ("--amplitude", "2"))):
        named = str(folder / rig) if rig.endswith(".py") else rig
        sent, rec = folder / f"{rig}-sent.csv", folder / f"{rig}-rec.csv"
        for words in (
            ["generate-aprbs", "--rig", named, "--duration", "12", *more, "--output", str(sent)],
            ["simulate", "--rig", named, "--excitation", str(sent), "--output", str(rec)],
        ):
            assert frame.run(words) == 0
        found[rig] = read_recording(rec)
    return found


def proposed(rig: str, recording: Recording, e: Experiment, folder: Path) -> list[Path]:
    """The files of an entry of the menu, proposed after this recording."""
    evidence = split_recordings(rig_named(rig), [recording], [])
    bench = bench_of(evidence)
    columns = e.signals(bench)
    settings = tuple(s for s in e.settings(bench) if s)
    files = NEXT_FILES[: max(len(settings), 1)]
    experiment = NextExperiment(
        name=e.name,
        why=e.why,
        separates=("a", "b"),
        expected_separation=1.0,
        minutes=e.minutes_on(bench),
        excitation=files[0],
        excitations=files,
        settings=settings,
        cautions=(),
    )
    p = Proposal(experiment, columns, sent_with(evidence, bench, columns))
    p.write(lambda *names: [folder / name for name in names])
    paths = [folder / name for name in files]
    for path, setting in zip(paths, settings, strict=False):
        assert read_recording(path).known.items() >= setting.items()
    return paths


OF_MUSCLES = (*EXPERIMENTS, *MENU)
ENTRIES = [
    (rig, e)
    for rig, names in (
        ("one-dof", {e.name for e in OF_MUSCLES} - {"gravity-test"}),
        ("two-link", {e.name for e in OF_MUSCLES}),
        ("cart.py", {"odd-multisine", "slow-reversals", "constant-rate-ramps", "amplitude-sweep"}),
    )
    for e in OF_MUSCLES
    if e.name in names
]


def test_the_entries_walked_are_the_whole_menu(recorded, here):
    for rig, recording in recorded.items():
        assert menu(bench_of(split_recordings(rig_named(rig), [recording], []))) == [
            e for r, e in ENTRIES if r == rig
        ]


@pytest.mark.parametrize(
    ("rig", "e"),
    sampled(
        ENTRIES,
        lambda one: (
            one[0] == "cart.py"
            or (one[0], one[1].name) == ("one-dof", "torque-loops-two-pressures")
        ),
        lambda one: f"{one[0]} {one[1].name}",
    ),
)
def test_a_recommended_experiment_is_simulated_checked_and_taken(
    rig, e, here, run, recorded, taken
):
    made = []
    for k, path in enumerate(proposed(rig, recorded[rig], e, here)):
        made.append(f"new-{k}.csv")
        (diagnose,) = lines_of(
            run("simulate", "--rig", rig, "--excitation", str(path), "--output", made[-1])
        )
        run("check", made[-1], "--rig", rig)
        run(*diagnose, code=TAKEN)
    run("diagnose", str(recorded[rig].path), *made, "--rig", rig, "--output", "all", code=TAKEN)
    assert len(taken[-1].recordings) == len(made) + 1
    assert len(taken) == len(made) + 1


# ---- runs --------------------


@pytest.fixture(scope="module")
def cart(tmp_path_factory) -> Path:
    return record_cart(tmp_path_factory.mktemp("cart"))


@pytest.fixture
def undecided(monkeypatch) -> None:
    """Diagnoses in which the next family is in question, however far it is behind."""

    def pairs(d):
        assert d.cause is not None
        return [(d.cause, next(c for c in d.ranking if c.family != d.cause.family))]

    monkeypatch.setattr(next_experiment, "pairs_to_separate", pairs)


def files_to_send(text: str) -> list[str]:
    """Excitations that a diagnosis into the folder `run` proposes to send."""
    return [f"run/{name}" for name in re.findall(r"`(next-experiment\S*\.csv)`", text)]


def test_after_a_diagnosis(cart, here, run, undecided):
    text = run(
        "diagnose", str(cart), "--rig", "cart.py", *others(), "--jobs", "1", "--output", "run"
    )
    (report,) = lines_of(text)
    run(*report)
    files = files_to_send(text)
    assert files == ["run/next-experiment.csv"]
    rubs = ("--effect", "coulomb-friction")
    (diagnose,) = lines_of(
        run(*f"simulate --rig cart.py --excitation {files[0]} --output next.csv".split(), *rubs)
    )
    assert diagnose[-1] == "run-2"
    run("fit", str(cart), "next.csv", "--rig", "cart.py", "--output", "both")


def test_after_a_fit_scoring_and_listing_runs(cart, here, run, taken, undrawn):
    train, report = lines_of(run("fit", str(cart), "--rig", "cart.py", "--output", "run"))
    fitted = load_run(here / "run")
    page = answers_of(fitted, errors_of(fitted))[-1].details[0]
    (again,) = re.findall("`pamid (.*)`", page)
    run(*free(shlex.split(again)), code=TAKEN)
    text = run(*train, "--iterations", "2")
    assert lines_of(text) == [report] == lines_of(run("runs"))
    run(*report)
    other = record_cart(here, seconds=6.0)
    (report,) = lines_of(run("score", "run", str(other), "--rig", "cart.py"))
    run(*report)
    run("fit", str(other), "--rig", "cart.py", "--output", "other")
    (compare,) = lines_of(run("runs"))
    assert compare[:2] == ["report", "--compare"]
    run(*compare)


def test_after_a_forecast(here, run):
    sent = ["--rig", "cart.py", "--column", "force_n", "--amplitude", "3", "--duration", "6"]
    run("generate-aprbs", *sent, "--output", "sent.csv")
    effects = ["--effect", "coulomb-friction"]
    (simulate,) = lines_of(run("power", "--rig", "cart.py", "--excitation", "sent.csv", *effects))
    run(*free(simulate))


@pytest.mark.parametrize("rig", ["one-dof", "./cart.py"])
def test_from_a_log_to_a_recording(rig, cart, here, run):
    """A mapping names a rig's file; that is run only where the line names it again."""
    log = here / "recording.csv"
    shutil.copy(cart if rig != "one-dof" else ROOT / "data" / "example" / "joint.csv", log)
    (ingest,) = lines_of(
        run(
            *f"ingest --guess recording.csv --rig {rig} --pressures gauge --kind csv".split(),
            *("--output", "map.toml"),
        )
    )
    assert (
        "--kind" in ingest
        and ingest[-1] == "recording-2.csv"
        and ("--rig" in ingest) == (rig != "one-dof")
    )
    (check,) = lines_of(run(*ingest))
    assert ("--rig" in check) == (rig != "one-dof")
    run(*check)


def test_what_is_missing_for_a_mapping_is_made_by_the_line_said(here, capsys):
    shutil.copy(ROOT / "data" / "example" / "joint.csv", "log.csv")
    assert frame.run(["ingest", "log.csv", "--output", "rec.csv"]) == 2
    (line,) = re.findall("`pamid (.*)`", capsys.readouterr().err)
    assert frame.run([*shlex.split(line), "--pressures", "gauge"]) == 0
    Path("map.toml").write_text(Path("map.toml").read_text().replace('"?"', '"1"'))
    assert frame.run(["ingest", "log.csv", "--mapping", "map.toml"]) == 0
    assert Path("recording.csv").is_file()
    assert frame.run(["ingest", "log.csv", "--mapping", "map.toml"]) == 3


@pytest.mark.parametrize("more", [(), ("--rig", "two-link", "--only", "no-gap")])
def test_after_a_share_of_a_trial(more, here, run, monkeypatch, capsys):
    """The cases themselves are left out."""
    drawn: list[tuple[Any, ...]] = []

    def scored(output, chosen, *_, **__):
        drawn.append((chosen.part, chosen.count, chosen.seed, chosen.rig, chosen.only))
        raise PamidError("taken", exit_code=TAKEN)

    monkeypatch.setattr(trial_work, "run_cases", lambda *_, **__: [])
    monkeypatch.setattr(trial_work, "run_trial", scored)
    text = run(
        "trial", "--output", "shared", "--index", "1/2", "--cases", "3", "--seed", "4", *more
    )
    (score,) = lines_of(text, "When all shares are finished: ")
    run(*score, code=TAKEN)
    assert drawn == [("test", 3, 4, *(("two-link", "no-gap") if more else ("one-dof", "")))]


def test_after_a_demo(recorded, here, run, taken):
    shutil.copytree(recorded["one-dof"].path.parent, here / "demo-run")
    (here / "demo-run" / "one-dof-rec.csv").rename(here / "demo-run" / "rec.csv")
    truth = {"effect": "valve-dead-band", "family": "valve", "as_simulated": [], "parameters": {}}
    text = demo_text(
        {
            "withheld": truth,
            "hit": "right",
            "sentence": "",
            "causes": [],
            "parameters": {},
            "how_far": {},
            "network": {},
            "page": "x",
        },
        Path("demo-run"),
    )
    story, diagnose = lines_of(text)
    run(*story)
    run(*free(diagnose), code=TAKEN)


@pytest.mark.parametrize("command", ["effects", "rigs"])
def test_one_of_them_is_there(command, here, run):
    line = run(command).splitlines()[-1]
    run(*shlex.split(line.split("pamid ")[1]))


def test_after_a_check(recorded, here, run, taken):
    """Also where a column is missing, and where no rig has these columns."""
    whole = recorded["one-dof"].path
    (line,) = lines_of(run("check", str(whole), "--rig", "one-dof"))
    run(*line, code=TAKEN)
    assert line[0] == "diagnose" and len(taken) == 1
    text = whole.read_text()
    Path("less.csv").write_text(text.replace("command", "comand"))
    told = run("check", "less.csv", "--rig", "one-dof", code=3)
    (again,) = lines_of(told, "Next: repair it, then ")
    run(*again, code=3)
    rows = [",".join(row.split(",")[:3]) for row in text.splitlines()[1:]]
    Path("odd.csv").write_text("\n".join(["time_s,drive_n_m,turn_rad", *rows]) + "\n")
    (new_rig,) = lines_of(run("check", "odd.csv"))
    assert new_rig[0] == "new-rig"
    run(*new_rig, "--like", "servo-axis")


def test_every_command_that_prints_such_a_line_is_walked():
    printing = {
        path.stem
        for path in (ROOT / "cli").glob("*.py")
        if re.search(r'["n]Next: ', path.read_text())
    }
    assert printing == {
        "check",
        "demo",
        "diagnose",
        "fit",
        "force_law",
        "generate_aprbs",
        "ingest",
        "new_rig",
        "power",
        "runs",
        "score",
        "simulate",
        "train_residual",
    }


# ---- to the end, slow --------------------


@pytest.mark.slow
def test_the_example_of_the_readme_and_what_it_recommends(here, run, undecided):
    example = ROOT / "data" / "example" / "joint.csv"
    text = run("diagnose", str(example), "--rig", "one-dof", "--output", "run")
    files = files_to_send(text)
    assert "Next experiment  Torque loops two pressures." in text and len(files) == 2
    for k, path in enumerate(files):
        machine = "--effect coulomb-friction:torque_n_m=0.4 --set damping_m2_s=7e-4 --set scale=1.1"
        sent = f"--excitation {path} --seed {k} --output next-{k}.csv"
        run("simulate", *f"{machine} {sent}".split())
    together = run(
        "diagnose", str(example), "next-0.csv", "next-1.csv", "--rig", "one-dof", "--output", "all"
    )
    assert together.startswith("coulomb-friction")
    run(*lines_of(together)[0])
