"""README, CONTRIBUTING, data/README and all of docs/ say what is true: commands, options, names,
links, and the cart."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest
import tutorials
from pamid_cli.table import COMMANDS, load_command

from pamid.base.schemas.diagnosis_file import Verdict
from pamid.model.effect import KINDS
from pamid.model.registry import effects, rigs
from pamid.simulation.virtual_rig import split_spec

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "SECURITY.md",
    ROOT / "data" / "README.md",
    ROOT / "data" / "rigs" / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
README, CART_PAGE = PAGES[0], ROOT / "docs" / "tutorials" / "own-rig.md"
VERDICTS = set(get_args(Verdict))
#: hyphenated words in backquotes that are neither commands nor members of the catalogue
OTHER = {"my-effect", "lint-imports"}
#: files that a reader is to write
TO_WRITE = {"pamid/effects/NAME.py", "pamid/effects/my_effect.py"}


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of a language, those that are files to write (`title=`) included."""
    return re.findall(
        rf'^```{language}(?: title="[^"]+")?\n(.*?)^```$',
        page.read_text(encoding="utf-8"),
        re.MULTILINE | re.DOTALL,
    )


def titles(page: Path) -> set[str]:
    """Files that a page has its reader write."""
    return set(re.findall(r'^```\w+ title="([^"]+)"$', page.read_text(encoding="utf-8"), re.M))


def prose(page: Path) -> str:
    """The page without its fenced blocks."""
    return re.sub(
        r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )


def quoted(page: Path) -> list[str]:
    """What stands in backquotes in the running text, on one line."""
    return [" ".join(found.split()) for found in re.findall(r"`([^`]+)`", prose(page))]


def command_lines(page: Path) -> list[list[str]]:
    """Every command line of a page, from its sh blocks and from its running text, as words."""
    lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
    lines += [
        text for text in quoted(page) if re.match(r"(\.venv/bin/)?pamid |make |python ", text)
    ]
    return [shlex.split(line, comments=True) for line in lines if line.strip()]


def anchors(page: Path) -> set[str]:
    """What a link may lead to within a page: its headings, as every forge and mkdocs spell them."""
    heads = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", head).strip().lower().replace(" ", "-") for head in heads}


def options_of(name: str) -> set[str]:
    params = load_command(name).params
    return {word for one in params for word in (*one.opts, *one.secondary_opts)}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_commands_and_their_options_exist(page):
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    seen = 0
    for words in command_lines(page):
        if words[0] == "make":
            assert words[1] in targets, words
        elif words[0] == "python":
            assert (ROOT / words[1]).is_file() or words[1] in titles(page), words
        elif words[0].removeprefix(".venv/bin/") == "pamid" and words[1] != "--help":
            assert words[1] in COMMANDS, f"{' '.join(words)}: no command {words[1]!r}"
            known = {"--help", *options_of(words[1])}
            assert not [w for w in words[2:] if w.startswith("--") and w not in known], words
        seen += 1
    # a page of docs/ may be words alone; all others tell what to type
    assert seen or (ROOT / "docs") in page.parents


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_effects_and_rigs_named_exist(page):
    names = {*effects(), *rigs(), *COMMANDS, *VERDICTS, *KINDS, *OTHER}
    for words in command_lines(page):
        for option, value in zip(words, words[1:], strict=False):
            if option == "--effect" and not value.endswith(".py"):
                assert split_spec(value)[0].partition("@")[0] in effects(), value
            if option != "--rig" or value.startswith("./") or value in titles(page):
                continue
            assert (ROOT / value).is_file() if value.endswith(".py") else value in rigs(), value
    for text in quoted(page):
        if re.fullmatch(r"[a-z]+(-[a-z]+)+", text):
            assert text in names, f"{page.name} names {text!r}, which does not exist"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_files_linked_or_named_exist(page):
    links = [t for t in re.findall(r"\]\(([^)]+)\)", prose(page)) if "://" not in t]
    for target in links:
        file, _, anchor = target.partition("#")
        assert (page.parent / file).is_file(), target
        assert not anchor or anchor in anchors(page.parent / file), target
    here, place = (
        [page.parent, ROOT],
        r"(pamid|tests|data|notebooks|benchmarks|cli|rigs|example)/[\w./]+\.\w+",
    )
    for text in quoted(page):
        if text not in TO_WRITE and re.fullmatch(place, text):
            assert any((folder / text).is_file() for folder in here), f"{page.name} names {text}"


def test_the_first_two_commands_are_those_of_a_fresh_machine():
    assert blocks(README, "sh")[0].split("\n")[:2] == ["make demo", "make test"]


def test_the_cart_shown_is_the_cart_shipped():
    assert (ROOT / "data" / "rigs" / "cart.py").read_text(encoding="utf-8") in blocks(
        CART_PAGE, "python"
    )


def test_number_of_effects():
    assert f"a catalogue of {len(effects())} " in " ".join(
        README.read_text(encoding="utf-8").split()
    )


def test_python_blocks_compile():
    for page in PAGES:
        for block in blocks(page, "python"):
            compile(block, str(page), "exec")


def shape(line: str) -> str:
    """A line of output without its numbers: these may move in the last digits, the words may
    not."""
    return " ".join(re.sub(r"-?\d+(\.\d+)?(e-?\d+)?", "#", line).split())


def output_of(arguments: list[str], folder: Path) -> str:
    """Standard output of this Python with these arguments, run in a folder to a good end."""
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def missing_lines(shown: list[str], printed: str) -> list[str]:
    """Lines of a page that no printed line begins with, numbers aside."""
    given = [shape(line) for line in printed.splitlines()]
    return [line for line in shown if not any(one.startswith(shape(line)) for one in given)]


def answer_of(page: Path) -> list[str]:
    """Lines of the answer that a page shows."""
    shown = next(b for b in blocks(page, "text") if " % of the gap (P " in b)
    return [line for line in shown.splitlines() if line]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "lines"),
    [
        (README, ["motor.csv"]),
        (ROOT / "docs" / "how-to" / "read-the-answer.md", ["data/example/joint.csv"]),
    ],
    ids=["readme", "read-the-answer"],
)
def test_the_answer_shown_is_the_answer_given(page, lines, tmp_path):
    (tmp_path / "data").symlink_to(ROOT / "data")
    printed = ""
    for words in command_lines(page):
        if words[0] != "pamid" or not set(words) & {"excitation.csv", *lines}:
            continue
        printed += output_of(["-m", "pamid_cli", *words[1:]], tmp_path)
    assert missing_lines(answer_of(page), printed) == [], printed


@pytest.mark.slow
def test_the_stock_robot_answers_as_shown(tmp_path):
    pytest.importorskip("mujoco", reason="pip install 'pamid[mujoco]'")
    page = ROOT / "docs" / "tutorials" / "own-robot.md"
    if why := tutorials.missing_package(page):
        pytest.skip(why)
    printed = ""
    for step in tutorials.steps(page):
        if step.name:
            (tmp_path / step.name).write_text(step.text, encoding="utf-8")
            continue
        program, *words = shlex.split(step.text)
        start = ["-m", "pamid_cli"] if program == "pamid" else []
        printed += output_of([*start, *words], tmp_path)
    shown = [line for block in blocks(page, "text") for line in block.splitlines() if line]
    assert shown and missing_lines(shown, printed) == [], printed
