# Two commands do the whole thing from nothing: `make report` and `make test`.
# They need python3 (3.11 or newer) and the network once, for the locked environment.

PYTHON ?= python3
UV_VERSION := 0.13.8
STAMP := .venv/.synced

# A run starts a hundred processes. Without bytecode, each would compile JAX and the other libraries anew: for 3 seconds.
unexport PYTHONDONTWRITEBYTECODE

# A uv of one's own is used if there is one; else a private copy is installed beside .venv.
UV := $(shell command -v uv 2>/dev/null || echo .uv/bin/uv)

.PHONY: report test test-all test-types test-lowest test-newest durations coverage bench docs lint format clean

# A process computes on each core already: more threads of the linear algebra only wait for each other.
test test-all test-types test-lowest test-newest durations coverage docs: export OPENBLAS_NUM_THREADS := 1

# What one page needs, no more: the tools of development and the extras come with `make test`.
report: | $(UV)
	$(UV) sync --quiet --inexact --locked --no-default-groups --python $(PYTHON)
	.venv/bin/erosion report

# All but what tests/slow.txt lists.
test: $(STAMP)
	.venv/bin/pytest --numprocesses 2 --dist loadfile -m "not slow"

# What CI runs.
test-all: $(STAMP)
	.venv/bin/pytest --numprocesses 2 --dist loadfile

# Lists in tests/slow.txt the tests that take more than a quarter of a second: on an otherwise idle machine.
durations: $(STAMP)
	.venv/bin/python -m pytest --numprocesses 2 --dist loadfile -p tests.durations

# Every call's shapes and types are checked, which takes three times as long: a nightly job.
test-types: $(STAMP)
	EROSION_CHECK_TYPES=1 .venv/bin/pytest --numprocesses 2 --dist loadfile

# The lower bounds in pyproject.toml are versions that work: each verb once, with the lowest of all, beside .venv.
test-lowest: | $(UV)
	$(UV) venv --quiet --clear --python $(PYTHON) .venv-lowest
	$(UV) pip install --quiet --python .venv-lowest --resolution lowest-direct --group dev --all-extras \
	  -r pyproject.toml -e .
	.venv-lowest/bin/pytest --numprocesses 2 tests/cli/test_each_verb.py

# JAX's newest versions need Python 3.12 or newer: what reads their jaxprs, with such a Python, beside .venv.
test-newest: | $(UV)
	UV_PROJECT_ENVIRONMENT=.venv-newest $(UV) sync --locked --all-extras --python $(PYTHON)
	.venv-newest/bin/pytest --numprocesses 2 --dist loadfile -m "not slow" tests/lanes tests/ode tests/impacts tests/models

# The lines of src/ that no test runs, by file.
coverage: $(STAMP)
	.venv/bin/pytest --numprocesses 2 --dist loadfile --cov

# Makes docs/performance.md: ten minutes, on an otherwise idle machine. `make bench ARGS=--quick` for a look. The nightly
# checks of ends, fits and posteriors: `make bench ARGS="--only random_ends fits"`.
bench: $(STAMP)
	$(UV) sync --inexact --locked --all-extras --group bench --python $(PYTHON)
	.venv/bin/python -m benchmarks.run $(ARGS)

# Every example is run; a warning is an error.
docs: $(STAMP)
	$(UV) sync --inexact --locked --all-extras --group docs --python $(PYTHON)
	.venv/bin/sphinx-build -W --keep-going -E -q -j auto docs docs/_build/html
	@echo "The documentation: $(CURDIR)/docs/_build/html/index.html"

lint: $(STAMP)
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/pyrefly check --summary=none
	.venv/bin/lint-imports

format: $(STAMP)
	.venv/bin/ruff check --fix .
	.venv/bin/ruff format .

clean:
	rm -rf .venv .venv-lowest .venv-newest .uv report docs/_build docs/api docs/examples

$(STAMP): pyproject.toml uv.lock | $(UV)
	$(UV) sync --locked --all-extras --python $(PYTHON)
	@touch $@

.uv/bin/uv:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "erosion needs Python 3.11 or newer; $$($(PYTHON) --version) is too old. Try: make PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || \
	  { echo "$(PYTHON) lacks the venv module; on Debian or Ubuntu: apt-get install python3-venv" >&2; exit 1; }
	$(PYTHON) -m venv .uv
	.uv/bin/pip install --quiet "uv==$(UV_VERSION)"

# uv on the PATH is no file of ours to make.
$(filter-out .uv/bin/uv,$(UV)):
