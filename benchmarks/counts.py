"""Size and language of the code and the documentation, counted.

    python benchmarks/counts.py [--old COMMIT] [--worst]

`--old` counts a second commit, read from git into a temporary folder, in a second column.
`--worst` also lists the places behind the counts of functions and docstrings.

Counted in `pamid` and `cli`, unless the row says otherwise:

- rooms, floors and arrows: folders of `pamid`, and `cli`, `benchmarks`, `data`, `notebooks`; the
  longest chain of imports between rooms; pairs of rooms with an import
- functions of the Python API: those that `pamid` itself offers
- parameters: `self`, `cls`, `*args` and `**kwargs` are left out
- called once: private functions whose name occurs once besides its definition
- comments: lines with a comment per line of code, in engine, estimation, diagnosis and networks
- words of the dialect: as whole words, in code and documentation without tests
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import subprocess
import tarfile
import tempfile
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from statistics import fmean

ROOT = Path(__file__).resolve().parents[1]
DIALECT = ("told", "said", "says", "asked", "beside", "foretold", "found", "one", "own")
COMMENTED = ("engine", "estimation", "diagnosis", "networks")
Function = ast.FunctionDef | ast.AsyncFunctionDef


def sources(*folders: Path) -> list[Path]:
    """Python files below folders, sorted."""
    return sorted(path for folder in folders for path in folder.rglob("*.py"))


def line_count(paths: list[Path]) -> int:
    """Lines of files."""
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)


def room_of(path: Path, root: Path) -> str:
    """Room that a file belongs to: a folder of `pamid`, or a folder at the top."""
    parts = path.relative_to(root).parts
    return parts[1].removesuffix(".py") if parts[0] == "pamid" else parts[0]


def arrows(root: Path, paths: list[Path]) -> set[tuple[str, str]]:
    """Pairs of rooms of which the first imports the second."""
    pairs = set()
    for path in paths:
        room = room_of(path, root)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module]
                if node.module in ("pamid", "pamid_cli"):
                    names = [f"{node.module}.{alias.name}" for alias in node.names]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            for name in names:
                top, _, rest = name.partition(".")
                other = {"pamid": rest.split(".")[0] or "__init__", "pamid_cli": "cli"}.get(
                    top, top
                )
                if top in ("pamid", "pamid_cli") and other != room:
                    pairs.add((room, other))
    rooms = {room_of(path, root) for path in paths}
    return {(a, b) for a, b in pairs if a in rooms and b in rooms}


def longest_chain(pairs: set[tuple[str, str]]) -> int:
    """Rooms on the longest chain of imports; arrows that close a circle are left out."""
    below: dict[str, set[str]] = {}
    for importer, imported in pairs:
        below.setdefault(importer, set()).add(imported)
    depth: dict[str, int] = {}

    def measure(room: str, above: frozenset[str]) -> int:
        if room not in depth:
            deeper = [measure(r, above | {room}) for r in below.get(room, ()) if r not in above]
            depth[room] = 1 + max(deeper, default=0)
        return depth[room]

    return max((measure(room, frozenset({room})) for room in list(below)), default=0)


def functions(paths: list[Path]) -> Iterator[tuple[str, Function, bool]]:
    """Place, definition and publicity of every function at the top of a module or a class."""
    for path in paths:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for parent in ast.walk(tree):
            if not isinstance(parent, ast.Module | ast.ClassDef):
                continue
            hidden = isinstance(parent, ast.ClassDef) and parent.name.startswith("_")
            for node in parent.body:
                if isinstance(node, Function):
                    public = not (hidden or node.name.startswith("_"))
                    yield f"{path}:{node.lineno} {node.name}", node, public


def parameter_count(node: Function) -> int:
    """Parameters of a function without self and cls."""
    names = [a.arg for a in node.args.posonlyargs + node.args.args + node.args.kwonlyargs]
    return len([name for name in names if name not in ("self", "cls")])


def api_homes(face: Path) -> dict[str, str]:
    """Names of the Python API and the files that define them, as parts of a path."""
    for node in ast.parse(face.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "_HOME":
            homes: dict[str, str] = ast.literal_eval(node.value)
            return {name: f"{home.replace('.', '/')}.py" for name, home in homes.items()}
    return {}


def docstrings(paths: list[Path]) -> Iterator[tuple[str, str]]:
    """Place and text of every docstring."""
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Module | ast.ClassDef | Function):
                text = ast.get_docstring(node)
                if text:
                    yield f"{path}:{getattr(node, 'lineno', 1)}", text


def comment_share(paths: list[Path]) -> float:
    """Lines with a comment per line that is not blank."""
    comments = filled = 0
    for path in paths:
        text = path.read_text(encoding="utf-8")
        filled += sum(1 for line in text.splitlines() if line.strip())
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        comments += sum(1 for token in tokens if token.type == tokenize.COMMENT)
    return comments / filled if filled else 0.0


def sentence_lengths(path: Path) -> list[int]:
    """Words of every sentence of a Markdown page; code, tables and headings are left out."""
    text = re.sub(r"(?ms)^(```|~~~).*?^\1", "", path.read_text(encoding="utf-8"))
    text = re.sub(r"\]\([^)]*\)", "]", text)
    lines = [line for line in text.splitlines() if not re.match(r"\s*(\||#|!\[|<|[-=]{3,})", line)]
    text = re.sub(r"\n\s*([-*]|\d+\.) ", "\n\n", "\n".join(lines))
    lengths = []
    for paragraph in re.split(r"\n\s*\n", text):
        for sentence in re.split(r"(?<=[.!?:;])\s+", paragraph.strip()):
            words = re.findall(r"\w[\w'-]*", sentence)
            if len(words) > 2:
                lengths.append(len(words))
    return lengths


def counts(root: Path, worst: dict[str, list[str]]) -> dict[str, str]:
    """Figures of one checkout by name. worst: filled with the places behind some of them."""
    package = sources(root / "pamid", root / "cli")
    house = sources(*(root / n for n in ("pamid", "cli", "benchmarks", "data", "notebooks")))
    pairs = arrows(root, house)
    defined = list(functions(package))
    names = Counter(
        name for path in package for name in re.findall(r"\b_\w+", path.read_text(encoding="utf-8"))
    )
    private = {
        place: node.name
        for place, node, _ in defined
        if node.name.startswith("_") and not node.name.startswith("__")
    }
    once = [place for place, name in private.items() if names[name] == 2]
    many = [place for place, node, _ in defined if parameter_count(node) >= 8]
    homes = api_homes(root / "pamid" / "__init__.py")
    unsectioned = [
        place
        for place, node, public in defined
        if public
        and node.name in homes
        and homes[node.name] in place
        and parameter_count(node) > 2
        and "Parameters\n" not in (ast.get_docstring(node) or "")
    ]
    texts = list(docstrings(package))
    what = [place for place, text in texts if text.startswith("What ")]
    worst |= {"called once": once, "eight": many, "no section": unsectioned, "What": what}
    pages = sorted((root / "docs").rglob("*.md")) + [root / "README.md"]
    prose = [path.read_text(encoding="utf-8") for path in package + pages]
    words = Counter(w for text in prose for w in re.findall(r"[a-z]+", text.lower()))
    measured = sorted((root / "docs" / "measured").glob("*.md"))
    lengths = [n for page in pages for n in sentence_lengths(page)]
    rows = {
        "lines of pamid + cli": line_count(package),
        "lines of tests": line_count(sources(root / "tests")),
        "lines of benchmarks": line_count(sources(root / "benchmarks")),
        "rooms": len({room_of(path, root) for path in house if path.name != "__init__.py"}),
        "floors": longest_chain(pairs),
        "arrows": len(pairs),
        "functions": len(defined),
        "functions with eight or more parameters": len(many),
        "private functions called once": len(once),
        "docstrings that open with 'What'": len(what),
        "docstring, mean words": round(fmean(len(text.split()) for _, text in texts)),
        "functions of the Python API with over two parameters, without a section": len(unsectioned),
        "README, words": len((root / "README.md").read_text(encoding="utf-8").split()),
        "docs/measured, words": sum(len(p.read_text(encoding="utf-8").split()) for p in measured),
        "sentence in the documentation, mean words": f"{fmean(lengths):.1f}",
        "sentences over 25 words": f"{fmean(n > 25 for n in lengths):.0%}",
    }
    rows |= {
        f"comments in {room}": f"{comment_share(sources(root / 'pamid' / room)):.1%}"
        for room in COMMENTED
    }
    rows |= {f"'{word}'": words[word] for word in DIALECT}
    return {name: str(value) for name, value in rows.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description="Size and language of code and documentation.")
    parser.add_argument("--old", metavar="COMMIT", help="a commit to compare with")
    parser.add_argument("--worst", action="store_true", help="list the places behind the counts")
    options = parser.parse_args()
    worst: dict[str, list[str]] = {}
    columns = {"now": counts(ROOT, worst)}
    if options.old:
        with tempfile.TemporaryDirectory() as folder:
            archive = subprocess.check_output(["git", "archive", options.old], cwd=ROOT)
            with tarfile.open(fileobj=io.BytesIO(archive)) as files:
                files.extractall(folder, filter="data")
            columns = {options.old: counts(Path(folder), {}), **columns}
    print("| | " + " | ".join(columns) + " |")
    print("|---|" + "---:|" * len(columns))
    for name in columns["now"]:
        print(f"| {name} | " + " | ".join(column[name] for column in columns.values()) + " |")
    if options.worst:
        for name, places in worst.items():
            print(f"\n{name}:", *places, sep="\n  ")


if __name__ == "__main__":
    main()
