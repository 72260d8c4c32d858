# make demo      see it happen: the real service, four bodies, a picture and a log
# make test      every test but the page's (make test-page)   make check   format, lint, types and the fast tests
# make lint      format, lint and types alone
# make install   the set-up alone      make fix     format and mend what the linter can mend
# make bench     the benchmark tables  make lock    renew constraints.txt
# make mutants   faults in the modules that keep people safe, and whether a test notices each
# make docs      the site, in out/site make pictures, make measure   what it shows, made again
# make screens   the operator's page in all its states, and what axe-core finds there
PYTHON ?= python3.11
PY := .venv/bin/python
SOURCES := gpdf_service clients schemas tests docs/tools
# What open3d's shared library links against on Debian and Ubuntu.
SYSTEM_PACKAGES := libgl1 libegl1 libx11-6 libgomp1 libusb-1.0-0

# Without compiled modules each of the processes that tests begin compiles all that it imports.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-page install check fast lint fix bench lock mutants schemas docs pictures screens measure system clean
.DEFAULT_GOAL := install

install: .venv/warm

# What is imported is compiled then: pip would compile 10,500 files, 25 s of one core while the others wait.
.venv/installed: pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is not on the PATH: install Python 3.11, or name one: make PYTHON=/path/to/python3.11"; exit 1; }
	@$(MAKE) --no-print-directory system
	$(PYTHON) -m venv .venv
	$(PY) -m pip install --quiet --constraint constraints.txt --upgrade pip
	$(PY) -m pip install --quiet --no-compile --constraint constraints.txt --editable '.[all]' --group dev
	@touch $@

# Compiling takes all cores for minutes, once. What a change of a kernel touches comes again.
.venv/warm: .venv/installed $(shell grep -rl --include=*.py njit gpdf_service)
	.venv/bin/gpdf warm
	@touch $@

system:
	@if command -v ldconfig >/dev/null && ! { ldconfig -p | grep -q 'libusb-1.0.so.0' && ldconfig -p | grep -q 'libGL.so.1' \
	    && ldconfig -p | grep -q 'libEGL.so.1' && ldconfig -p | grep -q 'libX11.so.6' && ldconfig -p | grep -q 'libgomp.so.1'; }; then \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $(SYSTEM_PACKAGES) >/dev/null; \
	  else \
	    echo "Open3D needs system libraries that are missing here. Run: sudo apt-get install $(SYSTEM_PACKAGES)"; exit 1; \
	  fi; fi

demo: install
	.venv/bin/gpdf demo --out out

# One more at once than there are cores: who asks a service waits for half of the time. What several need to compile may
# be compiled by each, which costs less than waiting. The longest modules begin (tests/conftest.py), so that no core
# waits at the end for another's.
WORKERS ?= $(shell $(PYTHON) -c 'import os; print(len(os.sched_getaffinity(0)) + 1)' 2>/dev/null || echo 3)
PYTEST := $(PY) -m pytest -n $(WORKERS) --dist loadscope --no-loadscope-reorder

test: install
	$(PYTEST) -m "not browser"

test-page: install
	@if command -v npm >/dev/null; then npm --prefix tests/phone ci --no-audit --no-fund >/dev/null; fi
	$(PY) -m pytest -m browser

lint: .venv/installed
	.venv/bin/ruff format --check $(SOURCES)
	.venv/bin/ruff check $(SOURCES)
	.venv/bin/mypy

# Types take one core for half a minute, where nothing was checked before: beside the rest no core waits.
check:
	@$(MAKE) --no-print-directory -j 2 lint fast

fast: install
	$(PYTEST) -q -m "not slow and not browser"

fix: install
	.venv/bin/ruff format $(SOURCES)
	.venv/bin/ruff check --fix $(SOURCES)

bench: install
	.venv/bin/gpdf bench field --plot out/bench_field.png
	.venv/bin/gpdf bench build
	.venv/bin/gpdf bench plan
	.venv/bin/gpdf bench paper --markdown out/paper.md --png out/paper
	.venv/bin/gpdf bench service
	.venv/bin/gpdf bench drive

lock: install
	.venv/bin/uv pip compile pyproject.toml --all-extras --group dev --python-version 3.11 --no-header --no-annotate --upgrade -o constraints.txt

mutants: install
	$(PY) tests/mutants.py --each $(or $(EACH),30) --seed $(or $(SEED),0) --only $(or $(ONLY),"")

schemas: install
	$(PY) -m gpdf_schemas.generate schemas/json

docs: install
	NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --strict

pictures: install
	$(PY) docs/tools/pictures.py

screens: install
	$(PY) docs/tools/screens.py

measure: install
	$(PY) docs/tools/measure.py

clean:
	rm -rf .venv out build dist
