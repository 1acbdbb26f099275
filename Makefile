# The targets install everything they need; a fresh machine only has to have Python 3.11 or later.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PYTEST := $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder
export OMP_NUM_THREADS ?= 1
# Keep compiled bytecode: hundreds of tests start a new Python process.
export PYTHONDONTWRITEBYTECODE =

.PHONY: env demo reproduce test test-doors test-all check styled typed documented installed dist bench bench-env pyvbmc-env docs clean

env: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=24"
	$(BIN)/python -m pip install --quiet --editable ".[test,mkl]"
	touch $@

$(VENV)/.installed-check: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --editable ".[test,mkl,check]"
	touch $@

# The main job: 1000 fluid-structure runs, surrogate, posterior, figures, report.
demo: env
	env -u OMP_NUM_THREADS $(BIN)/strandline run studies/biofilm-uniform

# Run all examples of the published study and judge its claims.
reproduce: env
	$(BIN)/python -m verification.reproduction

# What a change needs: the parts, one finished study of each kind, and the quickest of the doors.
test: env
	$(PYTEST) -m "not long and (smoke or not doors)" tests/unit tests/study tests/doors

# The other doors: processes, browser, notebooks, Dask, UM-Bridge, CalculiX, and a SLURM that the tests start.
# Skipped where programs are missing (Debian: slurmctld slurmd slurm-client munge calculix-ccx chromium).
test-doors: env
	$(PYTEST) -m "not long and not smoke" tests/doors

test-all: env
	$(PYTEST) tests

# The parts of a check run two at a time; what each prints stays together.
check: $(VENV)/.installed-check
	$(MAKE) --no-print-directory -j2 -O installed documented styled typed

styled: $(VENV)/.installed-check
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(PYTEST) -q -m "not long" tests/check

# Types and shapes of arrays at run time: twice the seconds of the same tests without. Whole studies call the same functions.
typed: $(VENV)/.installed-check
	$(PYTEST) -q -m "not long and not stand_in and not repeats" --jaxtyping-packages=strandline,verification.reproduction,beartype.beartype tests/unit

documented: $(VENV)/.installed-check
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html

# Test the wheel alone, in empty environments, with this Python and the newest one found (see STRANDLINE_PYTHONS).
installed: $(VENV)/.installed-check
	$(BIN)/python -m verification.validation.installed

# Source distribution and wheel, in dist/.
dist: $(VENV)/.installed-check
	$(BIN)/python -m hatchling build

docs: $(VENV)/.installed-check
	$(BIN)/python -m sphinx -W -b html docs docs/_build/html

# Compare strandline with other programs: about a quarter of an hour, best on an idle machine.
bench: bench-env
	$(BIN)/python -m verification.benchmarks

# The other programs have their own environment. Without it, the benchmark reports what it did not measure.
bench-env: env
	$(BIN)/python -m verification.benchmarks.peers.install

# PyVBMC, for `python -m verification.validation.pyvbmc`.
pyvbmc-env: env
	$(BIN)/python -m verification.benchmarks.peers.install pyvbmc

clean:
	rm -rf docs/_build .pytest_cache .mypy_cache .ruff_cache
