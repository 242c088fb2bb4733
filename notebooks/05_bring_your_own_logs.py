# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Bring your own logs
#  A bench writes what it likes: semicolons and decimal commas, a preamble, German names, pressures
# in bar above vacuum, and a clock that the PC reads when it gets round to it.
# `data/example/bench_log.csv` is such a log, of a joint with something that its data sheet does not
# know. Five commands lead from it to the answer; no Python is needed, this story only calls them.

# %%
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent if "__file__" in globals() else Path.cwd()
LOG = HERE.parent / "data" / "example" / "bench_log.csv"
temporary = tempfile.TemporaryDirectory()
folder = Path(temporary.name)


def pamid(*words: str | Path) -> dict[str, Any]:
    """Run a command; its JSON answer. A refusal ends the story with pamid's own words."""
    done = subprocess.run(
        [sys.executable, "-m", "pamid_cli", *map(str, words), "--json"],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    answer = json.loads(done.stdout)
    if done.returncode:
        raise SystemExit(f"{answer.get('message', answer)} {answer.get('hint', '')}")
    return answer


print("\n".join(LOG.read_text("cp1252").splitlines()[:8]))

# %% [markdown]
# ## 1. A first mapping
#  `--guess` reads the log and writes down what it takes each channel for. Two things it never
# guesses: whether pressures count from vacuum or from the air around (we say so here), and what is
# known of the rig (we say the inertia). It also looks at the clock: stamps that come late and
# samples that were taken late look alike, and the cure of the one makes the other a hundred times
# worse. The moving signals tell which it is.

# %%
guessed = pamid(
    "ingest",
    "--guess",
    LOG,
    "--rig",
    "one-dof",
    "--pressures",
    "absolute",
    "--known",
    "inertia_kg_m2=0.0896",
    "--output",
    "map.toml",
)
print(guessed["toml"])

# %% [markdown]
# ## 2. The recording
#  Look the mapping through, correct it, keep it: it serves for every log of this bench. With it a
# log becomes a recording and an account of all that was done to it.

# %%
account = pamid("ingest", LOG, "--mapping", "map.toml", "--output", "bench.csv")["recordings"][0]
for clock in account["clocks"]:
    print(f"{clock['name']}: {clock['cure']}")
    print(f"  {clock['why']}")
    for repair in clock["repairs"]:
        print(f"  {repair['detail']}")

# %% [markdown]
# ## 3. Is it fit for use?

# %%
checked = pamid("check", "bench.csv", "--figure", "card.png")
for finding in checked["findings"]:
    print(f"{'ok' if finding['ok'] else 'note':5s} {finding['check']}: {finding['detail']}")
for column, about in checked["quality"]["channels"].items():
    print(f"  {column:18s} noise {about['noise']:.3g}, span {about['span']:.4g}")

# %% [markdown]
# ## 4. What is missing in the model

# %%
found = pamid("diagnose", "bench.csv", "--output", "run", "--jobs", "2")
print(found["sentence"])
for cause in found["causes"]:
    print(
        " ",
        cause["effect"],
        {
            k: f"{v['value']:.4g} ({v['low']:.4g} .. {v['high']:.4g})"
            for k, v in cause["parameters"].items()
        },
    )
assert found["verdict"] == "explained" and found["causes"][0]["family"] == "muscle-hysteresis"

# %% [markdown]
# ## 5. A page to show
#  One file with every sample in it, zoomable, that opens anywhere. 60 N of hysteresis were planted
# in the muscles.

# %%
page = pamid("report", "run")["page"]
print(f"{Path(folder, page).stat().st_size / 1e6:.2f} MB")

# %%
temporary.cleanup()
