# Targets: run (the paper's case), test, test-slow, lint, golden, golden-update, sweep, bench, figures, extremes, accuracy, paper, clean.
# All of them install what they need into $(VENV); nothing but Python 3.11 or later with venv is asked of the machine.

PYTHON ?= python3
VENV ?= .venv
CONFIG ?= configs/euv_two_mirror.yaml
STEM = $(basename $(notdir $(CONFIG)))
OUTPUT ?= $(STEM)_psf
PYTEST_ARGS ?= -n auto --maxprocesses 8

# make accuracy: how many draws, of which seed, and further options of scripts/accuracy.py
N ?= 60
SEED ?= 1
ACCURACY_ARGS ?=

# make paper: with DOCS=1 the pictures of README.md as well
DOCS ?=

# an interpreter of another version gets a new environment
PYTHON_VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)
READY := $(VENV)/.python-$(PYTHON_VERSION)
INSTALLED := $(VENV)/.installed
INSTALLED_ALL := $(VENV)/.installed-all
PIP_INSTALL = $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

# make sweep: the field angles, their unit, further options of psfcli run, and the command itself
FIELDS ?= 0 0.1 0.2 0.3 0.4 0.5
FIELD_UNIT ?= deg
SWEEP_ARGS ?=
SWEEP := sweep/$(STEM)
SWEEP_FIELDS := $(sort $(FIELDS))
SWEPT := $(SWEEP_FIELDS:%=$(SWEEP)/field_%/manifest.json)
ifeq ($(origin PSFCLI), undefined)
PSFCLI := $(VENV)/bin/psfcli
SWEEP_NEEDS := $(INSTALLED)
endif

.PHONY: run test test-slow lint golden golden-update sweep bench figures extremes accuracy paper clean always
.DELETE_ON_ERROR:
.SUFFIXES:

run: $(INSTALLED)
	$(VENV)/bin/psfcli run $(CONFIG) --output $(OUTPUT) --overwrite
	@echo "The products are in $(OUTPUT)/"

test: $(INSTALLED_ALL)
	$(VENV)/bin/python -m pytest $(PYTEST_ARGS)

# what takes minutes a test: one process, for these tests have their own
test-slow: $(INSTALLED_ALL)
	$(VENV)/bin/python -m pytest -m slow

lint: $(INSTALLED_ALL)
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/mypy

golden: $(INSTALLED)
	$(VENV)/bin/python scripts/golden.py check

golden-update: $(INSTALLED)
	$(VENV)/bin/python scripts/golden.py update

bench: $(INSTALLED_ALL)
	$(VENV)/bin/python scripts/bench.py

# make accuracy N=1000 SEED=1: random systems held against the judge of the tests
accuracy: $(INSTALLED_ALL)
	$(VENV)/bin/python scripts/accuracy.py $(N) --seed $(SEED) $(ACCURACY_ARGS)

# every picture and measured table of README.md and docs/, and the price tags of psfcli run --help
figures: $(INSTALLED_ALL)
	$(VENV)/bin/python scripts/figures.py

extremes: $(INSTALLED_ALL)
	$(VENV)/bin/python scripts/extremes.py

# Table 1 and Figs. 6 to 10 of the paper into paper/, and whether its claims hold
paper: $(INSTALLED_ALL)
	$(VENV)/bin/python scripts/paper.py $(if $(DOCS),--docs)

# One directory per angle, done when its manifest stands and is younger than the request; then one table of them all.
sweep: $(SWEPT)
	@$(PYTHON) scripts/sweep_merge.py $(SWEEP)/ee.csv $(SWEPT:manifest.json=ee.csv)
	@echo "The table of $(words $(SWEPT)) angles is $(SWEEP)/ee.csv"

$(SWEEP)/field_%/manifest.json: $(SWEEP)/request
	@echo "$(STEM): field $* $(FIELD_UNIT)"
	@$(PSFCLI) run $(CONFIG) --field="$* $(FIELD_UNIT)" --output $(@D) --overwrite --jobs 1 --quiet $(SWEEP_ARGS) >/dev/null

# what every angle was computed from: it changes, and makes all angles old, only when its content does
$(SWEEP)/request: always | $(SWEEP_NEEDS)
	@mkdir -p $(@D)
	@{ $(PSFCLI) --version && echo '$(subst ','\'',$(FIELD_UNIT) $(SWEEP_ARGS))' && cat $(CONFIG); } >$@.new
	@if cmp -s $@.new $@; then rm $@.new; else mv $@.new $@; fi

$(READY):
	@test -n "$(PYTHON_VERSION)" || { echo "psfcli needs Python 3.11 or later, and $(PYTHON) does not run; say make PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	{ echo "psfcli needs Python 3.11 or later; $(PYTHON) is $(PYTHON_VERSION); say make PYTHON=..." >&2; exit 1; }
	rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(INSTALLED): $(READY) pyproject.toml constraints.txt
	$(PIP_INSTALL) --editable .
	@touch $@

$(INSTALLED_ALL): $(INSTALLED)
	$(PIP_INSTALL) --editable '.[plot,test,lint]'
	@touch $@

clean:
	rm -rf $(VENV) sweep paper build dist *.egg-info *_psf *_psf.png *_tradeoff *_bsdf *_fit *_validation .mypy_cache .pytest_cache .ruff_cache
	find psfcli scripts tests -name __pycache__ -prune -exec rm -rf {} +

always:
