# Each target is one line that a person could type; what it needs is installed first, into $(VENV).
# Works from a bare checkout with nothing but make and a Python: 3.11 or 3.10, for which all packages have wheels, or a
# newer one and a C++ compiler.

PRESET  = kit1000
DATA    = data/$(PRESET)
WORKERS =
PARTS   =
PYTHON  =
VENV    = .venv
BIN     = $(VENV)/bin
SITE    = site
SUBMISSIONS = submissions
SCORED  = $(patsubst %/scores.json,%,$(wildcard $(SUBMISSIONS)/*/scores.json))
RERUN   =
PAGES   = $(BIN)/python -m benchmark pages --submissions "$(SUBMISSIONS)" --out "$(SITE)/board"
RESCORE = $(BIN)/python -m benchmark rescore $(SCORED) --data "$(DATA)" --workers $(or $(WORKERS),2)
UPGRADE =
ROWS    = runs/table2
AREA    =
AREAS   = $(sort $(patsubst tests/%/,%,$(dir $(wildcard tests/*/test_*.py tests/*/*/test_*.py))))
TESTED  = $(if $(AREA),$(if $(filter $(AREA),$(AREAS)),tests/$(AREA),$(error no tests of $(AREA): AREA is one of $(AREAS))))
PYTEST  = $(BIN)/python -m pytest --numprocesses 2 --dist loadfile
CHANGED = { git diff --name-only --diff-filter=d HEAD; git ls-files --others --exclude-standard; } 2>/dev/null \
          | grep -E '^(kit1000|benchmark|baselines|bench|examples|tests)/.*\.py$$'
LAYERS  = $(BIN)/lint-imports --no-cache --no-logo
ROW     = $(BIN)/python -m baselines predict --data "$(DATA)" --tracks snap-d415 $(if $(WORKERS),--workers $(WORKERS))
OUT     =
TO      = $(if $(OUT),--out "$(OUT)/speed-$(1).json")
MEASURED = $(if $(wildcard $(DATA)/dataset.json),"$(DATA)")
MEASURE = --sensor d415 --components "$(ROWS)/components.json"

# A stamp is touched last of all and removed first of all, so an install that was cut short is never taken for done.
RUN  = $(VENV)/.installed-run
DEV  = $(VENV)/.installed-dev
TORCH = torch==2.13.0 # outside the lock: the same version is another build on another machine
PIP  = $(BIN)/python -m pip --disable-pip-version-check --quiet
VIEWERS = .viewers
ENGINE = $(VIEWERS)/mujoco
MUJOCO = mujoco==4.0.0 # outside the lock, in an environment of its own
LOCK = $(BIN)/uv pip compile pyproject.toml --group pyproject.toml:build --universal --python-version 3.10 \
       --generate-hashes --quiet $(if $(UPGRADE),--upgrade) --custom-compile-command "make lock"

unexport PYTHONDONTWRITEBYTECODE # else each process compiles its libraries anew, for up to 4 s

.DEFAULT_GOAL = help
.DELETE_ON_ERROR:
.PHONY: help install browser dataset test test-slow check lint site wheel results table1 table2 bench portable mutants mujoco pictures lock clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z0-9-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))
	@echo
	@echo "  make dataset PRESET=tiny DATA=DIR WORKERS=N    another preset, folder, number of processes"
	@echo "  make install PYTHON=python3.12                 another interpreter than 3.11, 3.10 or the first that suits"

install: $(DEV) browser ## the environment alone: all commands then stand in .venv/bin

browser: ## Chromium for the tests of the pages, where it is missing and no password is asked
	@$(chromium)

dataset: $(RUN) ## the full KIT1000 under data/kit1000
	$(BIN)/kit1000 generate $(PRESET) --out "$(DATA)" $(if $(WORKERS),--workers $(WORKERS))

test: $(DEV) browser ## the test suite; AREA=kits runs tests/kits alone
	$(PYTEST) $(TESTED)

test-slow: $(DEV) browser ## the tests that take longer
	$(BIN)/python -m pytest -m slow $(TESTED)

check: $(DEV) ## in a minute: ruff, layers, types of changed files, tests that were short before and need no dataset
	$(BIN)/ruff check .
	$(LAYERS)
	@{ $(CHANGED) | xargs -r $(BIN)/pyright; } & types=$$!; $(PYTEST) --quick; tests=$$?; wait $$types && exit $$tests

lint: $(DEV) ## ruff, layers of imports, declared packages, types
	$(BIN)/ruff check .
	$(LAYERS)
	$(BIN)/deptry .
	$(BIN)/pyright

site: $(DEV) ## documentation, API reference and leaderboard, under site/; with DATA rescored
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet --site-dir "$(SITE)"
	$(if $(wildcard $(DATA)/dataset.json),$(PAGES) $$($(RESCORE) >&2 && echo --rescored),$(PAGES))

table1: $(DEV) ## Table I beside our scores; with DATA they are scored again, RERUN=50 answers 50 queries again too
	$(if $(wildcard $(DATA)/dataset.json),$(RESCORE))
	$(if $(RERUN),$(BIN)/python -m baselines rerun $(SCORED) --data "$(DATA)" --first $(RERUN) $(if $(WORKERS),--workers $(WORKERS)))
	$(BIN)/python -m benchmark table1 --submissions "$(SUBMISSIONS)"

table2: $(DEV) ## Table II of DATA (PRESET=real-like), rows under ROWS: each stage replaced by truth, carried out by the robot
	$(ROW) registration-gtvol --out "$(ROWS)/true-shapes"
	$(ROW) registration-completed --out "$(ROWS)/masks-given"
	$(ROW) registration-completed --masks predicted --out "$(ROWS)/masks-found"
	$(ROW) guess --out "$(ROWS)/guess"
	$(BIN)/python bench/quality/segmentation.py "$(DATA)" $(MEASURE)
	$(BIN)/python bench/quality/completion.py parts "$(DATA)" $(MEASURE)
	$(BIN)/python bench/quality/completion.py kits "$(DATA)" $(MEASURE)
	$(BIN)/python -m benchmark table2 $(addprefix "$(ROWS)"/,true-shapes masks-given masks-found guess) --data "$(DATA)" \
	    --masks predicted --components "$(ROWS)/components.json" --out "$(ROWS)/table2.json"

wheel: $(DEV) ## build wheel and sdist under dist/, check them, and use the wheel alone in an empty folder
	rm -rf dist && $(BIN)/python -m hatchling build --target wheel --target sdist --directory dist
	$(BIN)/twine check --strict dist/*
	$(BIN)/python -m pytest -m slow tests/test_wheel.py

results: $(DEV) ## fill the tables of README and docs from results/ and submissions/
	$(BIN)/python -m benchmark documents README.md $$(grep -rl "<!-- result:" docs --include=*.md)

bench: $(DEV) ## each speed beside a reference of the same run, on DATA, else on tiny; OUT=results writes them too
	$(if $(PARTS),$(BIN)/python bench/speed/kit_files.py "$(PARTS)" $(call TO,kit-files))
	$(BIN)/python bench/speed/reading.py $(MEASURED) $(call TO,reading)
	$(BIN)/python bench/speed/scoring.py $(MEASURED) $(call TO,scoring)
	$(BIN)/python bench/speed/methods.py $(MEASURED) $(call TO,methods)

portable: $(DEV) ## generate tiny and small as on another processor, and compare every byte
	$(BIN)/python bench/outside/portable.py tiny small

mutants: $(DEV) ## change sampled places of the scored modules in a copy: do the tests notice? About 15 minutes
	$(BIN)/python bench/outside/mutants.py

mujoco: $(ENGINE)/.installed ## insert parts of DATA, else of tiny, in MuJoCo; OUT=results writes what it measures
	$(ENGINE)/bin/python bench/outside/mujoco_scenes.py $(MEASURED) $(if $(OUT),--out "$(OUT)/mujoco.json")

pictures: $(DEV) ## draw the pictures of the README and the docs
	$(BIN)/python docs/pictures/draw.py
	$(BIN)/python docs/pictures/sensors.py
	$(BIN)/python docs/pictures/robot.py
	$(BIN)/python docs/pictures/curves.py
	$(BIN)/python docs/pictures/cameras.py

lock: $(DEV) ## pin in requirements/ what pyproject.toml asks for; UPGRADE=1 renews all versions
	$(PIP) install uv
	$(LOCK) --output-file requirements/run.txt --extra sim
	$(LOCK) --output-file requirements/dev.txt --extra dev --constraint requirements/run.txt

clean: ## remove the environment and all caches, never data
	rm -rf $(VENV) $(VIEWERS) build dist site .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -not -path './data/*' -prune -exec rm -rf {} +

# The environment. Without a stamp it is made from nothing; with one, pyproject.toml or a lock has changed since, and
# pip brings it up to date.
$(RUN): pyproject.toml requirements/run.txt
	@if [ -e $(RUN) ] && $(BIN)/python -c 'import pip' 2>/dev/null; then rm -f $(RUN) $(DEV); \
	    else sh requirements/environment.sh "$(VENV)" "$(PYTHON)"; fi
	@echo "installing what KIT1000 runs on into $(VENV)" >&2
	@sh requirements/install.sh "$(BIN)/python"
	@touch $(RUN)

$(DEV): $(RUN) requirements/dev.txt
	@rm -f $(DEV)
	@echo "installing what tests and lint need into $(VENV)" >&2
	@$(PIP) install --no-compile --require-hashes -r requirements/dev.txt
	@$(PIP) install --no-compile $(TORCH)
	@touch $(DEV)

$(ENGINE)/.installed: pyproject.toml requirements/run.txt
	@echo "installing MuJoCo into $(ENGINE)" >&2
	@sh requirements/environment.sh "$(ENGINE)" "$(PYTHON)"
	@sh requirements/install.sh "$(ENGINE)/bin/python"
	@$(ENGINE)/bin/python -m pip --disable-pip-version-check --quiet install $(MUJOCO)
	@touch $@

# Without a browser the tests of the pages are skipped and say so: it is no reason to stop.
SUDO = $(shell [ "$$(id -u)" = 0 ] || echo sudo -n)
define chromium
	for name in chromium chromium-browser google-chrome; do ! command -v $$name >/dev/null || exit 0; done; \
	command -v apt-get >/dev/null && { $(SUDO) apt-get update && $(SUDO) apt-get install -y chromium; } >/dev/null 2>&1 || \
	    echo "no Chromium here: tests of the pages will be skipped (Debian: apt-get install chromium)" >&2
endef
