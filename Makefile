PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN = .venv/bin

.PHONY: paper test tools bench clean

paper: .venv/installed        ## install, run the paper's example, write figures 3-8 and the report to paper-results/
	$(BIN)/undeadzone paper --out paper-results

test: .venv/tested            ## everything: format, lint, types, tests, docs
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/pytest -n 2

tools:                        ## what some tests need besides Python: compiler and emulator of a microcontroller, cppcheck, browser
	sh tests/tools.sh

bench: .venv/benched          ## the benchmarks, minutes; tables go to benchmarks/RESULTS.md
	$(BIN)/python -m benchmarks

clean:
	rm -rf .venv *-results *-check *-design *-ensemble *-tune *-identify .pytest_cache .mypy_cache .ruff_cache .hypothesis

.venv/installed: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	touch $@

.venv/tested: .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
	touch $@

.venv/benched: .venv/tested
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[bench]'
	touch $@
