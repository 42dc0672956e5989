# make demo | test | long | oldest | check | docs | pictures | bench | notebooks | clean
# The first run creates .venv with the versions pinned in constraints.txt; `make oldest` creates .venv-oldest beside it,
# with the oldest versions that pyproject.toml allows.

BIN := .venv/bin
STAMP := .venv/.installed
# Tests start many processes, each of which would compile every module anew.
unexport PYTHONDONTWRITEBYTECODE

PIP := $(BIN)/python -m pip -qq --disable-pip-version-check install -c constraints.txt
# Installs the pinned versions several times faster than pip.
UV := $(BIN)/uv pip install -q --python $(BIN)/python -c constraints.txt

OLDEST := .venv-oldest
# The part of the daily tests that meets every package: derivations, cone programs, each command, a diagnosis with its
# report, every format of logs, emitted code and files in MuJoCo and Pinocchio, a survey by Dask; a minute on two cores.
OF_OLDEST := $(addprefix tests/,modeling/chain modeling/codegen estimation/least_squares \
  estimation/reading/test_log_formats.py $(addprefix truewrench/,commands/test_fit_command.py \
  commands/test_compensate_command.py test_command_line.py test_survey.py))

.PHONY: demo test long oldest check docs pictures bench notebooks browser clean
.DEFAULT_GOAL := test

demo: $(STAMP)
	$(BIN)/truewrench demo --out demo_report

test: browser $(STAMP)
	$(BIN)/python -m pytest

long: browser $(STAMP)
	$(BIN)/python -m pytest -m long

oldest: $(OLDEST)/.installed
	$(OLDEST)/bin/python -m pytest -W ignore::DeprecationWarning $(OF_OLDEST)

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The manual: build/docs/index.html. A warning, such as a link that leads nowhere, is an error.
docs: $(STAMP)
	$(BIN)/python -m sphinx -E -a -W --keep-going -q -j 2 docs build/docs

# Pictures of the workbench in the manual.
pictures: browser $(STAMP)
	PYTHONPATH=$(CURDIR) $(BIN)/python docs/generator/workbench_pictures.py

bench: $(STAMP)
	$(BIN)/python -m benchmarks

notebooks: $(STAMP)
	PYTHONPATH=$(CURDIR) $(BIN)/python notebooks/builder.py

# Chromium, which the tests of the workbench drive and pip does not bring: installed once, where that is allowed.
browser:
	@found() { \
	  if test -n "$$CHROMIUM"; then command -v "$$CHROMIUM"; else command -v chromium || command -v chromium-browser; fi >/dev/null; \
	}; \
	if ! found && test -z "$$CHROMIUM" && test "$$(id -u)" = 0 && command -v apt-get >/dev/null; then \
	  echo "Chromium is missing: apt-get installs it, once"; export DEBIAN_FRONTEND=noninteractive; \
	  apt-get -qq update && apt-get -qq install --yes --no-install-recommends chromium >/dev/null; \
	fi; \
	found || { echo "Chromium, which the tests of the page drive, is missing: apt-get install chromium (Debian, as root)," \
	  "or name its program in the variable CHROMIUM" >&2; exit 1; }

clean:
	rm -rf .venv $(OLDEST) demo_report build dist docs/generated *.egg-info
	rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The build backend is pinned like everything else: installed first, then used without isolation.
$(STAMP): pyproject.toml constraints.txt
	@if ! $(BIN)/python -m pip --version >/dev/null 2>&1; then \
	  for python in python3.11 python3 ""; do \
	    test -n "$$python" || { echo "truewrench needs Python 3.11 or newer: install it and put python3.11 or python3 on PATH" >&2; exit 1; }; \
	    "$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && break; \
	  done; \
	  "$$python" -m venv --clear .venv; \
	fi
	@$(PIP) setuptools
	@{ $(PIP) uv && $(UV) --no-build-isolation -e '.[development]'; } \
	  || { echo "uv could not install the packages; pip tries" >&2; \
	       $(PIP) --no-build-isolation -e '.[development]'; }
	@touch $@

# Of what is required here the oldest, of what that requires in turn the newest. Deprecations there are of no concern.
$(OLDEST)/.installed: pyproject.toml | $(STAMP)
	@$(BIN)/uv venv -q --clear --python $(BIN)/python $(OLDEST)
	@$(BIN)/uv pip install -q --python $(OLDEST)/bin/python --resolution lowest-direct -e '.[all,tests]'
	@touch $@
