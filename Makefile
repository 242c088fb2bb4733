# make demo     sets up .venv and runs the whole pipeline on a virtual rig
# make test     sets up .venv, then lint, imports, types and tests
# make slow     the tests that take long
# make fuzz     100 000 damaged and hostile inputs, on two cores (one to two hours)
# make faults   kills and failing writes at every moment (long)
# make planted  plants every effect in turn (long)
# make docs     the documentation, into build/docs
# make docs-test  every command of the README and of the tutorials, in a clean environment (long)

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
TORCH := $(shell grep '^torch==' constraints.txt)
# PyPI's torch for Linux brings 4 GB of CUDA with it: where this index answers, torch is taken from there
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
ANSWERS := import sys, urllib.request; urllib.request.urlopen(sys.argv[1] + "/torch/", timeout=5)
# what `make test` runs: `make test TESTS=tests/unit/test_units.py`
TESTS ?=
# one process per core; a file's tests stay together, because they share what they set up
PYTEST := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile

.PHONY: demo test slow lint bench fuzz faults planted docs docs-test clean

demo: $(STAMP)
	$(BIN)/pamid demo --output demo-run --overwrite

test: lint
	$(PYTEST) $(TESTS)

slow: $(STAMP)
	$(PYTEST) -m slow

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(BIN)/mypy pamid cli

bench: $(STAMP)
	for script in benchmarks/waiting.py benchmarks/engine.py benchmarks/arm.py benchmarks/elman_pass.py; do OMP_NUM_THREADS=1 $(BIN)/python $$script || exit 1; done

fuzz: $(STAMP)
	$(BIN)/python benchmarks/fuzz.py

faults: $(STAMP)
	$(BIN)/python benchmarks/faults.py

# every effect of the catalogue planted and asked for: ten minutes and more
planted: $(STAMP)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/planted_truth.py
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/planted_general.py

# the pictures of the effects are kept in build/signatures
docs: $(STAMP)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

docs-test: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python tests/support/tutorials.py $(if $(TESTS),--tests '$(TESTS)')

# torch first and by itself: the wheel already there (or the index it is taken from) is then kept by what follows
$(STAMP): pyproject.toml constraints.txt
	@echo 'Installing into $(VENV): about 5 minutes on two cores and 2 GB of disk, 0.7 GB of it torch;'
	@echo '4 GB more where $(TORCH_INDEX) cannot be reached (make TORCH_INDEX=URL takes another one).'
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "pamid needs Python 3.11 or newer")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check '$(TORCH)' \
		$$($(PYTHON) -c '$(ANSWERS)' '$(TORCH_INDEX)' 2>/dev/null && echo --extra-index-url '$(TORCH_INDEX)')
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	$(BIN)/python -m pamid.api.compiling
	touch $@

clean:
	rm -rf demo-run build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
