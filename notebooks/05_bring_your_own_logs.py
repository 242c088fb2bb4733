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
# know.

# %%
import tempfile
from pathlib import Path

import pamid

HERE = Path(__file__).resolve().parent if "__file__" in globals() else Path.cwd()
LOG = HERE.parent / "data" / "example" / "bench_log.csv"
temporary = tempfile.TemporaryDirectory()
folder = Path(temporary.name)

print("\n".join(LOG.read_text("cp1252").splitlines()[:8]))

# %% [markdown]
# ## 1. A first mapping
#  `guess_mapping` reads the log and writes down what it takes each channel for. Two things it never
# guesses: whether pressures count from vacuum or from the air around (we say so here), and what is
# known of the rig (we say the inertia). It also looks at the clock: stamps that come late and
# samples that were taken late look alike, and the cure of the one makes the other a hundred times
# worse. The moving signals tell which it is.

# %%
guessed = pamid.guess_mapping(
    LOG,
    "one-dof",
    pressures="absolute",
    known={"inertia_kg_m2": 0.0896},
    output=folder / "map.toml",
)
print(guessed.text)

# %% [markdown]
# ## 2. The recording
#  Look the mapping through, correct it, keep it: it serves for every log of this bench. With it a
# log becomes a recording and an account of all that was done to it.

# %%
made = pamid.ingest(LOG, folder / "map.toml", output=folder / "bench.csv", progress=False)
print(made.summary())
(recording,) = made.recordings
recording

# %% [markdown]
# ## 3. Is it fit for use?

# %%
checked = pamid.check(recording)
print(checked.summary())
checked.plot()

# %% [markdown]
# ## 4. What is missing in the model

# %%
run = pamid.diagnose(recording, jobs=2, progress=False)
print(run)
assert run.verdict == "explained" and run.causes[0].family == "muscle-hysteresis"
run

# %% [markdown]
# ## 5. A page to show
#  One file with every sample in it, zoomable, that opens anywhere. 60 N of hysteresis were planted
# in the muscles.

# %%
page = pamid.report(run.save(folder / "run")).page
print(f"{page.stat().st_size / 1e6:.2f} MB")

# %%
temporary.cleanup()
