# SPDX-License-Identifier: Apache-2.0
# Two commands for a fresh machine: `make demo` and `make test`. Both build .venv first, once.

PYTHON   ?= python3
VENV     ?= .venv
SCENARIO ?= paper
ARGS     ?=
# Extra arguments for pytest, as in: make test PYTEST_ARGS="-k packaging"
PYTEST_ARGS ?=

override PREFIX := $(abspath $(VENV))
export VENV_PREFIX := $(PREFIX)
PY := "$$VENV_PREFIX/bin/python"
PIP_INSTALL := $(PY) requirements/pip_install.py
# A file that is not the one that was locked is refused.
LOCKED := --require-hashes --no-deps

# ament finds packages below these prefixes, and the virtual environment is ours.
export AMENT_PREFIX_PATH := $(PREFIX)
export PATH := $(PREFIX)/bin:$(PATH)
# Other machines on the network take no part, unless asked.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
# rclpy.init needs a home for its log files.
export HOME ?= $(PREFIX)
export SCENARIO

# A sourced ROS installation, or a parent process that runs on ROS wheels of its own, must not mix its
# libraries with those in .venv.
ifneq ($(ROS_DISTRO)$(_ROS_WHEELS_BOOTSTRAP_COMPLETE),)
unexport LD_LIBRARY_PATH
unexport RMW_IMPLEMENTATION
endif
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport PYTHONPATH
unexport PYTHONHOME
unexport VIRTUAL_ENV

# Everything that ends up in the installed package.
INSTALLED := setup.py setup.cfg package.xml pyproject.toml \
	$(shell find tactile_hand_ros config launch scripts resource -type f ! -path '*/__pycache__/*' 2>/dev/null | LC_ALL=C sort)

.PHONY: help demo run live test lint bench study docs docs-figures mutate lock audit setup clean FORCE
.DELETE_ON_ERROR:

help:
	@echo 'make demo                 the paper'"'"'s experiment across ROS 2 processes, recorded in runs/latest'
	@echo 'make run SCENARIO=name    any scenario of config/scenarios, or a file; ARGS="..." for the orchestrator'
	@echo 'make live SCENARIO=name   a hand with a page to watch it, steer it, pull at the object and break things'
	@echo 'make test                 ruff, mypy and all tests'
	@echo 'make bench                measure'
	@echo 'make study NAME=slip      a study: slip, loads, faults, invariance, engines, hands, random-hands, stalls or fuzz; ARGS="--help" for its options'
	@echo 'make docs                 build the documentation as a site, site/index.html'
	@echo 'make docs-figures         run the examples of the documentation, write their numbers and pictures into it'
	@echo 'make lint                 ruff and mypy'
	@echo 'make mutate               change lines on purpose: which changes does no test notice?'
	@echo 'make clean                remove .venv, build results and caches; runs/ stays'

demo: $(VENV)/.package
	@"$$VENV_PREFIX/bin/tactile-hand" run paper $(ARGS)

run: $(VENV)/.package
	@"$$VENV_PREFIX/bin/tactile-hand" run "$$SCENARIO" $(ARGS)

live: $(VENV)/.package
	@"$$VENV_PREFIX/bin/tactile-hand" live $(if $(filter-out file,$(origin SCENARIO)),"$$SCENARIO") $(ARGS)

bench: $(VENV)/.studies $(VENV)/.package
	@$(PY) bench $(ARGS)

study: $(VENV)/.studies $(VENV)/.package
	@$(PY) studies $(NAME) $(ARGS)

# `pytest`, not `python -m pytest`: the latter puts the source tree first, and the tests are to exercise what
# was installed. Message fields are not type-checked by default; in tests they are.
# The tests run even when lint complains, so that one run shows everything: first on all cores, file by file, then
# one by one those of a page that is drawn in real time.
REAL_TIME := test/cockpit
PYTEST = ROS_PYTHON_CHECK_FIELDS=1 "$$VENV_PREFIX/bin/pytest"
test: $(VENV)/.docs $(VENV)/.browser $(VENV)/.package
	@failed=0; \
	$(MAKE) --no-print-directory lint || failed=1; \
	if [ -n '$(PYTEST_ARGS)' ]; then \
		$(PYTEST) $(PYTEST_ARGS) || failed=1; \
	else \
		$(PYTEST) -n auto --dist loadfile $(addprefix --ignore=,$(REAL_TIME)) || failed=1; \
		$(PYTEST) $(REAL_TIME) || failed=1; \
	fi; \
	exit $$failed

lint: $(VENV)/.dev $(VENV)/.package
	"$$VENV_PREFIX/bin/ruff" check .
	"$$VENV_PREFIX/bin/mypy"

# At low priority: it takes both cores for a while.
mutate: $(VENV)/.dev $(VENV)/.package
	@PYTHONPATH=. nice $(PY) -m studies.mutation $(ARGS)

# docs/site_markdown.py is found by PYTHONPATH; the cache does not notice when the code has changed.
docs: $(VENV)/.docs $(VENV)/.package
	@PYTHONPATH=docs "$$VENV_PREFIX/bin/zensical" build --strict --clean

docs-figures: $(VENV)/.dev $(VENV)/.browser $(VENV)/.package
	@"$$VENV_PREFIX/bin/tactile-hand" reproduce --out docs/results/reproduction
	@$(PY) docs/draw_pages.py
	@$(PY) docs/draw_animation.py

setup: $(VENV)/.docs $(VENV)/.browser $(VENV)/.package

# After a pin has changed; uv is the only tool that this needs, and nothing else needs it.
lock: $(VENV)/.created
	@$(PIP_INSTALL) -r requirements/lock.txt
	@UV="$$VENV_PREFIX/bin/uv" sh requirements/lock.sh

# Asks a public database, so it needs a network.
audit: $(VENV)/.created
	@$(PIP_INSTALL) -r requirements/audit.txt
	@"$$VENV_PREFIX/bin/pip-audit" --disable-pip --require-hashes $(addprefix -r ,$(wildcard requirements/locked/*.txt))

# --- set-up: each stamp is made once and again when what it depends on changes -----------------------

# A virtual environment cannot be moved: build it again when the tree has been.
ifneq ($(shell cat '$(VENV)/.created' 2>/dev/null),$(PREFIX))
$(VENV)/.created: FORCE
endif

# Named on the command line or in the environment: not the one that .venv was made with?
ifneq ($(origin PYTHON),file)
ifneq ($(shell cat '$(VENV)/.python' 2>/dev/null),$(PYTHON))
$(VENV)/.created: FORCE
endif
endif

$(VENV)/.created:
	@command -v '$(PYTHON)' >/dev/null || { \
	echo "set-up: there is no '$(PYTHON)': install Python 3.10 to 3.14, or name one: make ... PYTHON=python3.12" >&2; \
	exit 1; }
	@$(PYTHON) requirements/check_python.py
	@echo 'set-up 1/3: virtual environment $(VENV)'
	@rm -rf "$$VENV_PREFIX"
	@$(PYTHON) -m venv "$$VENV_PREFIX"
	@echo '$(PYTHON)' > '$(VENV)/.python'
	@echo "$$VENV_PREFIX" > '$@'

$(VENV)/.run: requirements/locked/run.txt $(VENV)/.created
	@echo 'set-up 2/3: ROS 2 Jazzy and the libraries, about a minute and 1 GB'
	@$(PIP_INSTALL) $(LOCKED) $(addprefix -r requirements/locked/,run.txt)
	@touch '$@'

$(VENV)/.dev: requirements/locked/dev.txt requirements/locked/studies.txt requirements/locked/hands.txt $(VENV)/.run
	@echo 'set-up: test tools, and hands that exist'
	@$(PIP_INSTALL) $(LOCKED) $(addprefix -r requirements/locked/,run.txt studies.txt dev.txt hands.txt)
	@touch '$@'

$(VENV)/.docs: requirements/locked/docs.txt $(VENV)/.dev
	@echo 'set-up: what the documentation is built with'
	@$(PIP_INSTALL) $(LOCKED) $(addprefix -r requirements/locked/,run.txt studies.txt dev.txt docs.txt)
	@touch '$@'

# Without a browser only the tests of the report fail, and they say what is missing; it is looked for again next time.
$(VENV)/.browser: requirements/browser.sh $(VENV)/.created
	@if sh requirements/browser.sh; then touch '$@'; fi

$(VENV)/.studies: requirements/locked/studies.txt $(VENV)/.run
	@echo 'set-up: what studies run on'
	@$(PIP_INSTALL) $(LOCKED) $(addprefix -r requirements/locked/,run.txt studies.txt)
	@touch '$@'

# Changes only when a file is added or removed, which no time stamp would show.
$(VENV)/.sources: FORCE | $(VENV)/.created
	@echo '$(INSTALLED)' | cmp -s - '$@' || echo '$(INSTALLED)' > '$@'

# A real install, not `pip install -e`: an editable one has no data files, so ament would find no package,
# no executables and no configuration. It takes two seconds and 15 to compile the contact step, and happens again whenever a source is newer.
# What setuptools left behind goes first, or deleted modules would be installed again.
$(VENV)/.package: $(INSTALLED) $(VENV)/.sources $(VENV)/.run
	@echo 'set-up 3/3: tactile_hand_ros into $(VENV)'
	@rm -rf build/lib build/bdist.* *.egg-info
	@$(PIP_INSTALL) --no-deps --no-build-isolation --force-reinstall .
	@rm -rf build/lib build/bdist.* *.egg-info
	@cd "$$VENV_PREFIX" && $(PY) -m tactile_hand_ros.closed_loop.warm_up
	@touch '$@'

clean:
	rm -rf "$$VENV_PREFIX" build/lib build/bdist.* *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find tactile_hand_ros test bench studies scripts -name __pycache__ -type d -prune -exec rm -rf {} +
