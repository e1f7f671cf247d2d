# Two commands matter: `make demo` shows what feeddrive does, `make test` proves it.
# They need Python >= 3.11, pip and a network; no compiler.  Without make, README.md has them as plain command lines.

PYTHON ?= python3
VENV := .venv
LOCK := locks/dev.txt
LOCKED ?= yes
BIN := $(VENV)/bin

.DEFAULT_GOAL := help
.PHONY: help demo test page studio wheel release dist lock types tests slow slow-share fresh mutate bench docs format stubs clean

help:
	@echo "make demo    install into $(VENV), run the bundled job, name the report to open"
	@echo "make test    install into $(VENV), then ruff, pyright and the tests without the slow proofs"
	@echo "make studio  build the page of feeddrive studio (needs node and npm) and open it on a bundled axis"
	@echo "make wheel   build source distribution and wheel, install it elsewhere, and try demo and studio from it"
	@echo "make release VERSION=0.1.0    refuse what is not ready; build into dist/ and try it (WITH=\"python3.12 python3.13\")"
	@echo "make dist    source distribution, wheel and its bill of materials (SBOM, CycloneDX) into dist/"
	@echo "make lock    renew locks/dev.txt: the versions and hashes of all that development and CI install (needs uv)"
	@echo "make slow    the slow proofs, each with its reason (pytest -m slow --collect-only names them)"
	@echo "make fresh   the drawn tests on new seeds, which it prints (SEEDS=2: some 5 minutes on two cores)"
	@echo "make mutate  change each equation of the shipped laws a little: a claim of its paper must break (docs/internals/mutants.md); halve and double all constants"
	@echo "make bench   all benchmarks; they print their tables (needs gcc, takes long)"
	@echo "make docs    build the documentation into site/"
	@echo "make format  let ruff format and mend the sources, and write the stubs"
	@echo "make clean   remove $(VENV), site and caches"

demo: $(VENV)/installed
	$(BIN)/feeddrive demo

test: stubs
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
# workers and the commands that tests start read modules that are compiled, also where containers forbid to write them
	$(BIN)/python -m compileall -q src
# pyright has one thread, so that the tests begin beside it
	@$(MAKE) --no-print-directory -j 2 types tests

types: $(VENV)/installed-dev
	$(BIN)/pyright --pythonpath $(BIN)/python

# npm packages come by name with the hashes of page/package-lock.json; nothing of them is committed
page: src/feeddrive/studio/page/index.html

studio: page | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable ".[studio]"
	$(BIN)/feeddrive studio ball_screw

src/feeddrive/studio/page/index.html: $(shell find page/src -type f) page/index.html page/package-lock.json page/build.mjs
	cd page && npm ci --no-audit --no-fund && npm run build

# what is released works without the clone: source distribution, the wheel from it, demo and studio from the wheel
wheel: $(VENV)/installed-dev
	$(BIN)/python tests/released.py

# a release: VERSION=0.1.0, and further Pythons in which the wheel is tried (WITH="python3.12 python3.13")
release: $(VENV)/installed-dev page
	$(BIN)/python tests/released.py --version $(VERSION) $(addprefix --with ,$(WITH)) --out dist

# without build isolation: hatchling is that of the lock
dist: $(VENV)/installed-dev
	rm -rf dist
	$(BIN)/python -m build --no-isolation --outdir dist .
	$(BIN)/python tests/sbom.py dist

# for all systems and every Python from 3.11 on; UV=... names another uv
UV ?= uv
lock:
	$(UV) pip compile pyproject.toml --extra dev --universal --python-version 3.11 --generate-hashes --upgrade \
	    --quiet --custom-compile-command "make lock" --output-file $(LOCK)

# without MAKEFLAGS, since the exports that tests build have makefiles of their own; pytest rewrites the assertions of all
# files, a half of its collection, and keeps them for the next run, also where containers forbid to write what is compiled
tests: $(VENV)/installed-dev
	MAKEFLAGS= PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n 2 --dist loadfile -m "not slow"

slow: $(VENV)/installed-dev
	$(BIN)/python -m pytest -n 2 -m slow

# what .ci/run adds to `make test`: 40 s of the slow proofs, drawn by the hash of the commit
slow-share: $(VENV)/installed-dev
	$(BIN)/python -m pytest -n 2 --slow-share 40

# drawn tests on new seeds: before an issue is called resolved (make fresh SEEDS=20)
SEEDS ?= 2
fresh: $(VENV)/installed-dev
	MAKEFLAGS= $(BIN)/python tests/fresh_draws.py --count $(SEEDS)

mutate: $(VENV)/installed-dev
	$(BIN)/python tests/mutants.py
	$(BIN)/python tests/constant_mutants.py

bench: $(VENV)/installed-dev
	@for each in $$(grep -l '__name__ == "__main__"' benchmarks/*.py); do \
	    echo "== $$each"; $(BIN)/python $$each || exit 1; done

docs: $(VENV)/installed-dev
	$(BIN)/mkdocs build --strict

# the public names of packages for editors and type checkers
stubs: $(VENV)/installed-dev
	$(BIN)/python tests/stubs.py

format: stubs
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf $(VENV) site .pytest_cache .ruff_cache .hypothesis

$(BIN)/python:
	@$(PYTHON) -c 'import sys; v = sys.version_info; v >= (3, 11) or sys.exit("feeddrive needs Python >= 3.11; $(PYTHON) is %d.%d. Name another one: make demo PYTHON=python3.12" % v[:2])'
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

# what development and CI install: the files whose hashes are in the lock, and nothing that they would fetch to build.
# LOCKED=no takes the newest versions that pyproject.toml allows, as where the lock has no file for a Python or a system
$(VENV)/installed-dev: pyproject.toml $(LOCK) | $(BIN)/python
ifeq ($(LOCKED),no)
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
else
	$(BIN)/python -m pip install --quiet --require-hashes --requirement $(LOCK)
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
endif
	@touch $@ $(VENV)/installed
