"""The reference pages in Markdown: effects, rigs, commands, schemas, the Python face."""

from __future__ import annotations

import inspect
import re
import sys
import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import MISSING
from pathlib import Path
from typing import Any

import click
from pamid_cli.table import COMMANDS, load_command

import pamid
from pamid import equations
from pamid.api.options.record import about_fields
from pamid.base.schemas import all_schemas, earlier_schemas
from pamid.base.schemas.catalogue_files import EffectStory, ParameterRow
from pamid.base.symptoms import SYMPTOMS
from pamid.diagnosis.settings import described
from pamid.engine.symbolic.vocabulary import FUNCTIONS
from pamid.model import catalogue
from pamid.model.effect import KINDS
from pamid.model.registry import effects, rig_named, rigs

ROOT = Path(__file__).resolve().parents[2]
EFFECTS, RIGS, COMMAND_PAGES = "reference/effects/", "reference/rigs/", "reference/commands/"
SYMPTOM_PAGE = "how-to/symptoms.md"


def written_pages() -> Iterator[tuple[str, str]]:
    """Path in the site and text of every generated page."""
    stories = _stories()
    yield SYMPTOM_PAGE, _symptoms_page(stories)
    yield f"{EFFECTS}index.md", _catalogue_page(stories)
    for name, story in stories.items():
        yield f"{EFFECTS}{name}.md", _effect_page(story)
    for name in sorted(rigs()):
        yield f"{RIGS}{name}.md", _rig_page(name)
    yield f"{COMMAND_PAGES}index.md", _commands_page()
    for name in COMMANDS:
        yield f"{COMMAND_PAGES}{name}.md", _command_page(name)
    yield "reference/settings.md", _settings_page()
    yield "reference/schemas.md", _schemas_page()
    yield "reference/python.md", _face_page()
    yield "reference/equations.md", _equations_page()


def pictured(pages: dict[str, str]) -> dict[str, bytes | str]:
    """The pages of the effects with the pictures of their signatures, and the pictures."""
    folders = [str(ROOT / "docs" / "hooks"), str(ROOT / "tests" / "support")]
    sys.path[:0] = folders
    try:
        import signatures
    finally:
        del sys.path[: len(folders)]

    with_pictures: dict[str, bytes | str] = {}
    for name, (picture, where) in signatures.pictures(sorted(effects())).items():
        place = f"{EFFECTS}{name}.md"
        with_pictures[f"{EFFECTS}{name}.svg"] = picture
        shown = (
            f"![Signature of {name}: what enters and what leaves its port over time, and the "
            f"change over the signal that it follows]({name}.svg)\n\n"
            f"*What enters its port and what leaves it (left), and the relation between them "
            f"(right), at {where}, at its typical size.*\n\n"
        )
        head, equation, rest = pages[place].partition("## What it is\n")
        with_pictures[place] = head + shown + equation + rest
    with_pictures[SYMPTOM_PAGE] = _with_pictures(pages[SYMPTOM_PAGE])
    return with_pictures


def _with_pictures(page: str) -> str:
    """The page of symptoms, each with the signature of its first effect."""
    first = re.compile(r"(\n\| effect \|[^\n]*\n\|---[^\n]*\n\| \[`)([\w-]+)`")

    def pictured_table(match: re.Match[str]) -> str:
        path = f"../{EFFECTS}{match[2]}.svg"
        return f"\n![Signature of {match[2]}]({path})\n{match[0]}"

    return first.sub(pictured_table, page)


def navigation() -> dict[str, list[Any]]:
    """What stands in the navigation in place of a folder."""
    families: dict[str, list[Any]] = {}
    for name, effect in sorted(effects().items()):
        families.setdefault(effect.family, []).append({name: f"{EFFECTS}{name}.md"})
    return {
        EFFECTS: [f"{EFFECTS}index.md", *({k: v} for k, v in sorted(families.items()))],
        RIGS: [{name: f"{RIGS}{name}.md"} for name in sorted(rigs())],
        COMMAND_PAGES: [
            f"{COMMAND_PAGES}index.md",
            *({f"pamid {name}": f"{COMMAND_PAGES}{name}.md"} for name in COMMANDS),
        ],
    }


# ---- effects and rigs ----------------------------------------------------------------------------


def _stories() -> dict[str, EffectStory]:
    known = effects()
    looked_at = [rig_named(name) for name in rigs()]
    return {
        name: catalogue.effect_story(known[name], looked_at, known.values())
        for name in sorted(known)
    }


def _symptoms_page(stories: dict[str, EffectStory]) -> str:
    """Effects by the shape of the error that they cause."""
    lines = [
        "# What does your error look like?",
        "",
        "Plot what was measured over what the model predicts. Find the shape of the difference "
        "below. `pamid effects --symptom NAME` prints the same lists, and `pamid diagnose rec.csv "
        "--rig RIG --output run` decides between the effects.",
        "",
        "A policy that shakes on the real robot usually combines several: delays and lags "
        "([lags](#lags)), play ([reversals](#reversals)), friction ([stops-short](#stops-short)) "
        "and coarse sensors ([steps](#steps)).",
    ]
    for symptom, title in SYMPTOMS.items():
        members = [story for story in stories.values() if symptom in story.symptoms]
        members.sort(key=lambda story: (story.symptoms.index(symptom), bool(story.unit)))
        lines += [
            "",
            f"## {title} {{#{symptom}}}",
            "",
            f"`pamid effects --symptom {symptom}`",
            "",
            "| effect | in a recording | how to separate it |",
            "|---|---|---|",
        ]
        lines += [
            f"| [`{story.name}`](../{EFFECTS}{story.name}.md) "
            f"| {_cell(story.story.get('What it looks like', ''))} "
            f"| {_cell(story.story.get('Looks like it', ''))} |"
            for story in members
        ]
    return "\n".join(lines) + "\n"


def _catalogue_page(stories: dict[str, EffectStory]) -> str:
    """All effects by family."""
    families: dict[str, list[EffectStory]] = {}
    for story in stories.values():
        for family in dict.fromkeys(story.families.values()):
            families.setdefault(family, []).append(story)
    lines = [
        "# The catalogue of effects",
        "",
        f"{len(stories)} effects in {len(families)} families. A **family** holds effects with the "
        "same",
        "cause and like equations. Where an effect can act follows from the **kind** of a port; "
        "`pamid effects` prints the",
        "same list, and `pamid effects --rig RIG` what fits a rig.",
        "",
        "| kind of port | what passes through it |",
        "|---|---|",
        *(f"| `{kind}` | {what} |" for kind, what in KINDS.items()),
    ]
    for family, members in sorted(families.items()):
        lines += ["", f"## {family}", "", "| effect | acts on | |", "|---|---|---|"]
        for effect in members:
            kinds = ", ".join(f"`{k}`" for k, f in effect.families.items() if f == family)
            lines.append(
                f"| [`{effect.name}`]({effect.name}.md) | {kinds} | {_cell(effect.title)} |"
            )
    return "\n".join(lines) + "\n"


def _effect_page(story: EffectStory) -> str:
    lines = [f"# {story.name}", "", f"**{story.title}**", ""]
    needs = ", ".join(f"`{s}`" for s in story.signals)
    lines += [
        f"Family: {', '.join(dict.fromkeys(story.families.values()))}. "
        f"Acts on: {', '.join(f'`{k}`' for k in story.kinds)}"
        + (f" in {story.unit}" if story.unit else "")
        + (f", where the port offers {needs}" if needs else "")
        + ".",
        "",
    ]
    for signal, names in story.stand_ins.items():
        offered = ", ".join(f"`{n}`" for n in names)
        lines += [f"`{signal}` may be offered as {offered}.", ""]
    for title in ("What it is", "What it looks like", "Looks like it"):
        if story.story.get(title):
            lines += [f"## {title}", "", story.story[title], ""]
    if story.look_alikes:
        linked = ", ".join(f"[`{n}`]({n}.md)" for n in story.look_alikes)
        lines += [f"In the catalogue: {linked}.", ""]
    lines += ["## Equation", "", "```text", story.story.get("Equation", ""), "```", ""]
    lines += ["## Parameters", "", *_parameter_table(story.parameters), ""]
    if story.general_parameters:
        lines += ["At other ports of your rig:", ""]
        lines += [*_parameter_table(story.general_parameters), ""]
    if story.absorbed_by:
        names = ", ".join(f"`{n}`" for n in story.absorbed_by)
        lines += [f"Parameters of a rig that can stand in for it: {names}.", ""]
    lines += ["## Where it fits on the shipped rigs", ""]
    if story.places:
        lines += ["| rig | written as | ports | parameters there |", "|---|---|---|---|"]
        for place in story.places:
            ports = ", ".join(f"`{p}`" for p in place.ports)
            parameters = ", ".join(f"`{p.name}`" for p in place.parameters)
            lines.append(f"| `{place.rig}` | `{place.effect}` | {ports} | {parameters} |")
    else:
        lines.append("At no port of them; it serves your rigs.")
    if story.story.get("References"):
        lines += ["", "## References", "", story.story["References"]]
    return "\n".join(lines) + "\n"


def _parameter_table(rows: Iterable[ParameterRow]) -> list[str]:
    lines = [
        "| parameter | typical | range | counts in | off at | source |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        low, high = ("-" if bound is None else f"{bound:g}" for bound in (row.low, row.high))
        counts = f"multiples of {row.multiple_of}" if row.multiple_of else row.unit or "-"
        null = "" if row.null is None else f"{row.null:g}"
        lines.append(
            f"| `{row.name}` | {row.value:g} | {low} to {high} | {counts} | {null} | "
            f"{_cell(row.source)} |"
        )
    return lines


def _rig_page(name: str) -> str:
    story = catalogue.rig_story(rig_named(name), effects().values(), rigs())
    lines = [f"# {name}", "", story.title, "", f"What `pamid rigs {name}` prints.", ""]
    return "\n".join([*lines, "```text", catalogue.rig_text(story), "```", ""])


# ---- commands ------------------------------------------------------------------------------------


def _commands_page() -> str:
    lines = [
        "# Every command",
        "",
        "What `pamid --help` lists. All take `--json` (a single JSON object on standard output,",
        "also when they fail), `--debug` and `--help`.",
        "",
        "| command | |",
        "|---|---|",
        *(f"| [`pamid {name}`]({name}.md) | {_cell(line)} |" for name, line in COMMANDS.items()),
        "",
        "Exit codes: 0 done, 1 unexpected, 2 usage, 3 a file is wrong, 4 the data cannot answer, "
        "5 not converged,",
        "6 partly done (the rest is written), 7 a condition of `--fail-if` holds, 130 interrupted "
        "(what is finished is kept).",
    ]
    return "\n".join(lines) + "\n"


def _settings_page() -> str:
    lines = [
        "# Settings of a diagnosis",
        "",
        "Change one with `pamid diagnose ... --setting NAME=VALUE`, or with",
        "`pamid.diagnose(..., settings={NAME: VALUE})`. `--horizon` sets `horizon_s`.",
        "Probabilities of causes are calibrated under the defaults.",
        "",
        "| setting | default | unit | meaning | evidence |",
        "|---|---|---|---|---|",
        *(
            f"| `{s['name']}` | {s['default']:g} | {s['unit']} | {_cell(s['meaning'])} | "
            f"{_cell(s['evidence'])} |"
            for s in described()
        ),
    ]
    return "\n".join([*lines, ""])


def _command_page(name: str) -> str:
    command = load_command(name)
    context = click.Context(command, info_name=f"pamid {name}")
    usage = " ".join([f"pamid {name}", *command.collect_usage_pieces(context)])
    lines = [f"# pamid {name}", "", "```text", usage, "```", ""]
    for paragraph in re.split(r"\n\s*\n", (command.help or "").strip()):
        if paragraph.lstrip().startswith("\b"):
            listed = textwrap.dedent(paragraph.partition("\b")[2].lstrip(" ").strip("\n"))
            lines += ["```text", listed, "```", ""]
        else:
            lines += [_prose(" ".join(paragraph.split())), ""]
    lines += ["## Options", "", "| option | |", "|---|---|"]
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None:
            lines.append(f"| `{record[0].replace('|', ' or ')}` | {_cell(record[1])} |")
    example = getattr(command, "example", "")
    lines += ["", "## Example", "", "```sh", example, "```"]
    return "\n".join(lines) + "\n"


# ---- the rest ------------------------------------------------------------------------------------


def _schemas_page() -> str:
    lines = [
        "# JSON: what commands print and write",
        "",
        "Every object has a `schema` with its name and version. `pamid schema NAME` prints its",
        "full JSON schema; this page lists the keys at the top of each.",
    ]
    earlier = earlier_schemas()
    for name, schema in sorted(all_schemas().items()):
        lines += ["", f"## {name}", "", _prose(schema.get("title", "")), ""]
        lines += ["| key | |", "|---|---|"]
        for key, what in schema.get("properties", {}).items():
            lines.append(f"| `{key}` | {_cell(what.get('description', ''))} |")
        for number in (n for n in earlier if n.partition("/")[0] == name):
            lines += ["", f"### What became of each key of pamid.{number}", ""]
            lines += [f"`pamid schema {number}` prints that form; such files are still read.", ""]
            lines += ["| key | |", "|---|---|"]
            for key, fate in fates(earlier[number]).items():
                lines.append(f"| `{key}` | {fate or 'as it was'} |")
    return "\n".join(lines) + "\n"


def fates(schema: dict[str, Any]) -> dict[str, str]:
    """What became of every key at the top of an earlier schema, and of those below it that have
    changed; "" of one that is as it was."""
    return {
        path: fate
        for path, fate in _commented(schema, schema, "").items()
        if fate or "." not in path
    }


def _commented(schema: dict[str, Any], root: dict[str, Any], place: str) -> dict[str, str]:
    """The comment on every key below a place; none below a key that is gone."""
    comments: dict[str, str] = {}
    for branch in schema.get("anyOf", [schema]):
        branch = root["$defs"][branch["$ref"].rpartition("/")[2]] if "$ref" in branch else branch
        if isinstance(branch.get("items"), dict):
            comments |= _commented(branch["items"], root, f"{place}[]")
        if isinstance(branch.get("additionalProperties"), dict):
            comments |= _commented(branch["additionalProperties"], root, f"{place}.*")
        for key, what in branch.get("properties", {}).items():
            path = f"{place}.{key}" if place else key
            comments[path] = what.get("$comment", "")
            if not comments[path].startswith("gone"):
                comments |= _commented(what, root, path)
    return comments


_PARTS = {
    "Functions": "Each corresponds to the command of its name.",
    "Results": "Frozen and typed, read from the run folder.",
    "Parts of rig and effect files": "",
}


def _face_page() -> str:
    """Every name of the face, by part."""
    parts: dict[str, list[str]] = {part: [] for part in _PARTS}
    for name in sorted(pamid.__all__):
        if name == "report" or name.startswith("_"):
            continue
        home = pamid._HOME[name]
        results = home.startswith(("pamid.api", "pamid.intake.logs", "pamid.base"))
        part = list(_PARTS)[0 if name[0].islower() else 1 if results else 2]
        parts[part].append(f"::: {home}.{name}")
    lines = [
        "# Python functions",
        "",
        "`import pamid` offers these names; each is loaded on first use.",
        "`pamid.report(run, output=None, pdf=None)` writes the page of a run.",
    ]
    for part, what in _PARTS.items():
        lines += ["", f"## {part}", "", what, ""]
        for one in parts[part]:
            lines += [one, "", *_argument_table(getattr(pamid, one.rpartition(".")[2]))]
    return "\n".join(lines)


def _argument_table(function: Any) -> list[str]:
    """Arguments of a function whose arguments are the fields of a record."""
    if not hasattr(function, "record"):
        return []
    lines = ["| argument | default | |", "|---|---|---|"]
    for item, about in about_fields(function.record):
        default = "" if item.default is MISSING else f"`{item.default!r}`"
        lines.append(f"| `{item.name}` | {default} | {_cell(about.in_python or about.text)} |")
    return [*lines, ""]


def _equations_page() -> str:
    """Every function of `pamid.equations`, with its arguments and the first sentence on it."""
    lines = [
        "# Functions for equations",
        "",
        "Signals in rig and effect files take `+ - * / **`, comparisons, and these functions. "
        "Import them from `pamid.equations`; those of `math` or `numpy` do not work on signals.",
        "",
        "```python",
        "from pamid.equations import clip, delay, sin, where",
        "",
        "torque = -p.mass_kg * 9.81 * p.length_m * sin(x.angle)  # a pendulum",
        "command = clip(delay(u.voltage_v, p.delay_s, 0.05), -12.0, 12.0)  # a late, limited drive",
        "flow = where(x.level > p.rim_m, x.level - p.rim_m, 0.0)  # `if` does not work on signals",
        "```",
        "",
        "| function | meaning |",
        "|---|---|",
    ]
    for name in FUNCTIONS:
        function = getattr(equations, name)
        summary = " ".join((inspect.getdoc(function) or "").split("\n\n")[0].split())
        lines.append(f"| `{name}{_arguments(function)}` | {_cell(summary)} |")
    return "\n".join([*lines, ""])


def _arguments(function: Any) -> str:
    names = inspect.signature(function).parameters
    return f"({', '.join(names)})"


def _cell(text: str) -> str:
    """Text for a cell of a table."""
    return _prose(" ".join(text.split())).replace("|", "\\|")


def _prose(text: str) -> str:
    """Text that Markdown takes as it stands: underscores and stars in names, angle brackets."""
    return re.sub(r"(?<!`)([*_<>\[\]])", r"\\\1", text) if "`" not in text else text
