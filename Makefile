PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN = .venv/$(if $(filter Windows_NT,$(OS)),Scripts,bin)

FUZZ_SECONDS ?= 600
MUTANTS ?= 300

# Starts of Python that keep no bytecode cost a quarter of the tests' time.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: paper test quick long times test-wheel wheel tools bench docs fuzz mutants coverage clean

paper: .venv/installed        ## install, run the paper's example, write figures 1-8 and the report to paper-results/
	$(BIN)/undeadzone paper --out paper-results

test: .venv/tested            ## everything: format, lint, types, tests, docs; ten minutes on two cores
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy & types=$$!; $(BIN)/pytest -n 2; tests=$$?; wait $$types && exit $$tests

quick: .venv/tested           ## the same without the tests that take longest (tests/slow.txt), two minutes
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy & types=$$!; $(BIN)/pytest -n 2 -m "not slow and not long"; tests=$$?; wait $$types && exit $$tests

long: .venv/tested            ## statistics and strangers, an hour: nightly, and before a release
	$(BIN)/python -m benchmarks --write long_tests
	! grep '^Failed: ' benchmarks/RESULTS.md
	$(BIN)/python -m tests.reference --compare

times: .venv/tested           ## CPU seconds of each file of tests to tests/cpu.toml, slow tests to tests/slow.txt
	$(BIN)/pytest -n 2 --write-times

test-wheel: .venv/tested      ## the tests against an installed wheel in place of src
	$(BIN)/python tests/packed.py -n 2

wheel: .venv/tested           ## the wheels of all distributions in dist/, and a bill of materials (CycloneDX)
	rm -rf dist
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-build-isolation --no-deps --wheel-dir dist . ./packages/deadzone_update ./packages/undeadzone_arena
	$(BIN)/python -m tools.supply sbom dist/undeadzone-*.whl

fuzz: .venv/tested            ## random inputs for everything that reads something, FUZZ_SECONDS=600
	$(BIN)/python -m tools.fuzz --seconds $(FUZZ_SECONDS)

mutants: .venv/tested         ## do the tests notice a wrong sign? MUTANTS=300 of them, an hour or two
	$(BIN)/python -m tools.mutants map
	$(BIN)/python -m tools.mutants run --count $(MUTANTS)

coverage: .venv/tested        ## lines of src that no test runs
	$(BIN)/pytest -n 2 --cov=src --cov-report=term-missing:skip-covered

tools:                        ## what some tests need besides Python: compilers and emulators of microcontrollers, cppcheck, browser
	sh tests/tools.sh

bench: .venv/benched          ## the benchmarks, minutes; tables go to benchmarks/RESULTS.md
	$(BIN)/python -m benchmarks

docs: .venv/documented         ## the documentation site, in site/
	bash docs/site/vendor.sh
	$(BIN)/mkdocs build --strict

clean:
	rm -rf .venv site dist *-results *-check *-design *-ensemble *-tune *-identify .pytest_cache .mypy_cache .ruff_cache .hypothesis

.venv/installed: pyproject.toml packages/undeadzone_arena/pyproject.toml constraints.txt
	test -x $(BIN)/python$(if $(filter Windows_NT,$(OS)),.exe) || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e . -e packages/undeadzone_arena
	touch $@

.venv/tested: .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
	touch $@

.venv/documented: .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	touch $@

.venv/benched: .venv/tested
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[bench]'
	touch $@
