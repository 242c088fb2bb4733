"""No command runs a file that only data name: every command of the table, hostile words in every
place of every file that it reads, and code planted wherever such a word may lead."""

import copy
import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from identified_runs import SEEN, fitted_run, put_network, random_network
from pamid_cli import frame
from pamid_cli.table import COMMANDS
from synthetic_run import diagnosis_json, run_json, write_residual
from virtual_joint import record

from pamid.base.errors import DataError
from pamid.model import registry as library
from pamid.networks.elman import Elman

EVIL = """from pathlib import Path
Path({marker!r}).touch()
from pamid.rigs.one_dof import OneDof
from pamid.effects.coulomb_friction import CoulombFriction
class Evil(OneDof): pass
class EvilFriction(CoulombFriction): name = "evil"
"""
#: what leads, or once led, to a file; {place} is the folder that all of it is in
WORDS = (
    "one-dof:evil.py",
    "{place}/evil.py",
    "./evil.py",
    "evil.py",
    "../evil.py@joint",
    "./evil.py:torque_n_m=1",
    "evil",
    "coulomb-friction@{place}/evil.py",
)
#: files so called exist beside the run, in it, and where the command is given
PLANTED = ("evil.py", "one-dof:evil.py", "coulomb-friction@evil.py", "evil/__init__.py")
#: how many of the words a key is tried with that names code or may be taken to; the other keys take
#: turns
NAMING = {"rig": len(WORDS), "effects": 3, "effect": 2, "path": 1}
#: everything but a fault of pamid's
ALLOWED = {0, 2, 3, 4, 5, 6}
AT_ONCE = 8  # other keys in one copy
END = "as far as the test goes"

pytestmark = pytest.mark.usefixtures("unchecked")


@dataclass
class Trap:
    """A folder with planted code, and what has been run of it."""

    place: Path
    loaded: list[str] = field(default_factory=list)

    @property
    def marker(self) -> Path:
        return self.place / "code-was-run"

    def plant(self, folder: Path) -> None:
        for name in PLANTED:
            (path := folder / name).parent.mkdir(parents=True, exist_ok=True)
            path.write_text(EVIL.format(marker=str(self.marker)))

    def require_unsprung(self, told: object) -> None:
        assert not self.loaded and not self.marker.exists(), f"{told}: code was run: {self.loaded}"


@pytest.fixture
def trap(tmp_path, monkeypatch) -> Trap:
    """The working folder is the trap, and Python would import from it."""
    made = Trap(tmp_path)
    made.plant(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    real = library._run

    def noted(path, source):
        made.loaded.append(str(path))
        return real(path, source)

    monkeypatch.setattr(library, "_run", noted)
    return made


@pytest.fixture(autouse=True)
def quick(undrawn, monkeypatch) -> None:
    """What takes long and reads nothing more ends at once: fits, trainings, drawings."""

    def end(*arguments, **more):
        raise DataError(END)

    # the importing modules first: one that is imported while its source is patched keeps the patch
    for place in (
        "pamid.api.fitting.fit_model",
        "pamid.api.diagnosing.diagnose_into",
        "pamid.networks.correction.port_network.fit_robustly",
        "pamid.api.training.train_correction",
        "pamid.api.trial_cases.examine",
        "pamid.api.replications.papers.joint.reproduce",
        "pamid.api.replications.demonstration.run_demo",
        "pamid.networks.correction.force_map.judge",
        "pamid.estimation.grey_box.fit_model",
        "pamid.diagnosis.verdict.diagnosis_run.diagnose_into",
        "pamid.networks.correction.output_network.train_correction",
        "pamid.api.scoring.split_recordings",
    ):
        monkeypatch.setattr(place, end)
    monkeypatch.setattr("pamid.report.animation.gif_of", end)


# ---- hostile copies --------------------


def texts(node: Any, key: str = "") -> Iterator[tuple[Any, Any, str]]:
    """(holder, index, key) of every text, and of every empty list, which could hold one."""
    pairs = (
        node.items()
        if isinstance(node, dict)
        else enumerate(node)
        if isinstance(node, list)
        else ()
    )
    for at, value in list(pairs):
        called = str(at) if isinstance(node, dict) else key
        if isinstance(value, str) and called != "schema" or value == []:
            yield node, at, called
        else:
            yield from texts(value, called)


def keys_of(contents: dict[Path, Any]) -> list[str]:
    return sorted({key for content in contents.values() for _, _, key in texts(content)})


def with_texts(contents: dict[Path, Any], words: dict[str, str]) -> dict[Path, Any]:
    """The words wherever their keys stand, in all files."""
    made = copy.deepcopy(contents)
    for content in made.values():
        for holder, at, called in list(texts(content)):
            if called in words:
                holder[at] = [words[called]] if holder[at] == [] else words[called]
    return made


def with_names(contents: dict[Path, Any], word: str) -> dict[Path, Any]:
    """The word in place of one name of every table whose names are free: parameters, channels,
    values."""

    def renamed(node: Any) -> Any:
        if isinstance(node, list):
            return [renamed(one) for one in node]
        if not isinstance(node, dict):
            return node
        new = {key: renamed(value) for key, value in node.items()}
        free = [
            key for key in new if any(c in key for c in "_@:") and key not in ("sha256", "period_s")
        ]
        return {(word if key in free[:1] else key): value for key, value in new.items()}

    return {path: renamed(content) for path, content in contents.items()}


def hostile(folder: Path, place: Path, most: int) -> Iterator[tuple[str, dict[Path, Any]]]:
    """The JSON files of a folder as they are, and then spoilt in one way each."""
    contents = {path: json.loads(path.read_text()) for path in sorted(folder.rglob("*.json"))}
    words, keys = [word.format(place=place) for word in WORDS], keys_of(contents)
    yield "", contents
    for key in keys:
        for word in words[: min(most, NAMING.get(key, 0))]:
            yield f"{key} = {word}", with_texts(contents, {key: word})
    others = [key for key in keys if key not in NAMING]
    for first in range(0, len(others), AT_ONCE):
        chosen = dict(zip(others[first : first + AT_ONCE], words, strict=False))
        yield f"{chosen}", with_texts(contents, chosen)
    for word in words[:2]:
        yield f"names = {word}", with_names(contents, word)


def ask(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    """What a command says; whatever it is, no fault of pamid's."""
    code = frame.run([*words, "--json"])
    said: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert code in ALLOWED and said.get("code") != "unexpected", (words, code, said.get("message"))
    return said


def tried(
    trap: Trap,
    capsys: pytest.CaptureFixture[str],
    folder: Path,
    *commands: tuple[str, ...],
    most: int = len(WORDS),
) -> None:
    """Every command on every hostile copy of a folder, under that folder's name. The folder as it
    is has an answer, or takes the command to where this test ends it: what is shown here would else
    be that nothing is read."""
    good = folder.with_name(f"{folder.name}.good")
    folder.rename(good)
    for told, contents in hostile(good, trap.place, most):
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(good, folder)
        trap.plant(folder)
        for path, content in contents.items():
            (folder / path.relative_to(good)).write_text(json.dumps(content))
        for words in commands:
            said = ask(capsys, *words)
            trap.require_unsprung((words, told))
            assert told or said["schema"] != "pamid.error/1" or said["message"].startswith(END), (
                said["message"]
            )
            shutil.rmtree("out", ignore_errors=True)


# ---- what every command reads --------------------


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A run with everything in it, and the recording it was made with."""
    place = tmp_path_factory.mktemp("made")
    fitted_run(place / "run", record(place / "rec.csv", 6.0).path)
    record(place / "new.csv", 6.0, seed=2)
    put_network(place / "run", random_network(Elman(len(SEEN), 2), SEEN, "angle_deg", 1.0))
    (place / "run" / "diagnosis.json").write_text(
        json.dumps({**diagnosis_json("explained"), "sentence": "friction"})
    )
    write_residual(place / "run", causes=True, network=False)
    return place


def copied(made: Path, trap: Trap) -> Path:
    shutil.copytree(made, trap.place, dirs_exist_ok=True)
    return trap.place / "run"


Read = Callable[[Trap, pytest.CaptureFixture[str], Path], None]
READ: dict[str, Read] = {}


def reads(name: str) -> Callable[[Read], Read]:
    def noted(function: Read) -> Read:
        READ[name] = function
        return function

    return noted


def reads_files(name: str, *, recordings: str = "", runs: tuple[str, ...] = ()) -> None:
    """A command whose words end like this reads recordings, a run folder, or both; one of `--output
    out` also goes on with what it began."""

    def check(trap: Trap, capsys: pytest.CaptureFixture[str], made: Path) -> None:
        if recordings:
            read_recordings(trap, capsys, made, (name, *recordings.split()))
        folder = copied(made, trap)
        if runs:
            tried(trap, capsys, folder, *((name, *words.split()) for words in runs))
        if recordings.endswith("--output out"):
            resumed(trap, capsys, made, name)

    READ[name] = check


def read_recordings(
    trap: Trap, capsys: pytest.CaptureFixture[str], made: Path, *commands: tuple[str, ...]
) -> None:
    """Hostile words in the TOML beside a recording."""
    copied(made, trap)
    sidecar = trap.place / "rec.toml"
    good = sidecar.read_text()
    named = [
        good.replace('rig = "one-dof"', f"rig = '{word.format(place=trap.place)}'")
        for word in WORDS
    ]
    known = good.replace("[known]", "[known]\n'./evil.py' = 1")
    for text in (*named, known, f"{good}\n[evil]\neffect = './evil.py'\n"):
        assert text != good
        sidecar.write_text(text)
        for words in commands:
            ask(capsys, *words)
            trap.require_unsprung((words, text))
            shutil.rmtree("out", ignore_errors=True)
    sidecar.write_text(good)


def resumed(trap: Trap, capsys: pytest.CaptureFixture[str], made: Path, command: str) -> None:
    """An unfinished run, and one that claims to be finished."""
    words = (command, "rec.csv", "--output", "begun")
    ask(capsys, *words)
    begun = trap.place / "begun"
    for outcome in ("failed", "done"):
        record = json.loads((begun / "run.json").read_text())
        (begun / "run.json").write_text(json.dumps({**record, "outcome": outcome}))
        for name in ("fit.json", "diagnosis.json"):
            shutil.copy(made / "run" / name, begun)
        tried(trap, capsys, begun, (*words, "--resume"), most=2)
        shutil.rmtree(begun)
        (trap.place / "begun.good").rename(begun)


ONE_STEP = "run --iterations 1"
reads_files("report", runs=("run",))
reads_files("runs", runs=("run",))
reads_files("export", runs=("run --to c --output out",))
reads_files("animate", runs=("run --output out/x.gif",))
reads_files("train-residual", runs=(ONE_STEP, f"{ONE_STEP} --at joint"))
reads_files("check", recordings="rec.csv")
reads_files("power", recordings="--excitation rec.csv --jobs 1")
reads_files("score", recordings="run rec.csv", runs=("run new.csv",))
reads_files("fit", recordings="rec.csv --output out", runs=("rec.csv --from run --output out",))
reads_files("diagnose", recordings="rec.csv --output out")
reads_files(
    "simulate",
    recordings="--excitation rec.csv --output out/x.csv --force",
    runs=("--model run --excitation rec.csv --which refitted --output out/x.csv",),
)


@reads("new-rig")
def _new_rig(trap: Trap, capsys: pytest.CaptureFixture[str], made: Path) -> None:
    """Names of columns are written into a program: whatever they are, it is none but the one
    meant, and it is not run."""
    time = "".join(f"{0.01 * k:.2f},{k % 7},{k % 5}\n" for k in range(80))
    wicked = 'x"""; import evil; """_n'
    for name in ("force_n", "x); import evil #_n", "__import__('evil')_n", "class_n", wicked):
        (trap.place / "rec.csv").write_text(
            'time_s,"{}",position_1_mm\n{}'.format(name.replace('"', '""'), time)
        )
        for more in ((), ("--like", "two-masses"), ("--column", f"force_n={name}")):
            ask(capsys, "new-rig", "rec.csv", *more, "--overwrite")
            trap.require_unsprung((name, more))
    read_recordings(trap, capsys, made, ("new-rig", "rec.csv", "--overwrite"))


@reads("trial")
def _trial(trap: Trap, capsys: pytest.CaptureFixture[str], made: Path) -> None:
    words = ("trial", "--output", "trial", "--cases", "2", "--jobs", "1", "--part", "calibration")
    ask(capsys, *words)
    assert len(list((trap.place / "trial" / "cases").iterdir())) == 2
    tried(trap, capsys, trap.place / "trial", (*words, "--resume"), ("report", "trial"))


@reads("reproduce-paper")
def _reproduce(trap: Trap, capsys: pytest.CaptureFixture[str], made: Path) -> None:
    (trap.place / "paper").mkdir()
    (trap.place / "paper" / "run.json").write_text(json.dumps(run_json()))
    words = ("reproduce-paper", "--quick", "--output", "paper", "--resume")
    tried(trap, capsys, trap.place / "paper", words)


@reads("ingest")
def _ingest(trap: Trap, capsys: pytest.CaptureFixture[str], made: Path) -> None:
    for word in WORDS:
        word = word.format(place=trap.place)
        (trap.place / "log.csv").write_text(
            f't,{word},"x\' ""y"\nrig = \'{word}\'"\n'
            + "".join(f"{0.003 * k:.3f},{k % 7},{k % 3}\n" for k in range(200))
        )
        ask(capsys, "ingest", "--guess", "log.csv", "--output", "map.toml", "--overwrite")
        for text in (
            f"rig = '{word}'\n[signals.angle_deg]\nsource = '{word}'\nunit = 'deg'\n",
            (trap.place / "map.toml").read_text(),
        ):
            (trap.place / "map.toml").write_text(text)
            ask(capsys, "ingest", "log.csv", "--mapping", "map.toml", "--output", "out")
        trap.require_unsprung(word)


@reads("force-law")
def _force_law(trap: Trap, capsys: pytest.CaptureFixture[str], made: Path) -> None:
    for word in WORDS:
        (trap.place / "map.csv").write_text(
            f"contraction,pressure_kpa,force_n,{word}\n" + "0.1,100,50,1\n" * 9
        )
        ask(capsys, "force-law", "map.csv", "--output", "law", "--overwrite")
        trap.require_unsprung(word)


#: commands that read no data
READ_NOTHING = {
    "generate-aprbs": "generate-aprbs --duration 5 --output sent.csv",
    "effects": "effects coulomb-friction",
    "rigs": "rigs one-dof",
    "schema": "schema",
    "completion": "completion bash",
    "demo": "demo --output out",
    "config": "config",
}


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_runs_what_only_data_name(command, trap, made, capsys):
    """`READ` says what a command reads; one that is not in it has been forgotten."""
    (trap.place / "sent.toml").write_text("[recording]\nrig = './evil.py'\n")
    if command in READ_NOTHING:
        ask(capsys, *READ_NOTHING[command].split())
    else:
        READ[command](trap, capsys, made)
    trap.require_unsprung(command)


def test_the_trap_works(trap, capsys):
    ask(capsys, "rigs", "./evil.py")
    assert trap.loaded == ["evil.py"] and trap.marker.exists()
