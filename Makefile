# Each target makes the virtual environment and installs what it needs by itself: git, make and Python >= 3.10 suffice.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out/demo
BENCH_OUT ?= out/bench

.PHONY: demo test test-nightly lint docs bench browser clean

$(VENV)/.installed: pyproject.toml CMakeLists.txt $(wildcard coopqp/control/core/*.[ch])
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "coopqp needs Python >= 3.10: make PYTHON=python3.x ...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

demo: $(VENV)/.installed
	$(BIN)/coopqp demo --out $(OUT)

test: $(VENV)/.installed
	@mkdir -p out
	$(BIN)/python -m pytest --reliability-json out/reliability.json

# The catalogue of docs/reliability.md with ten times the cases, random ones each time; hours.
test-nightly: $(VENV)/.installed
	@mkdir -p out
	HYPOTHESIS_PROFILE=nightly $(BIN)/python -m pytest tests/reliability --timeout 36000 --reliability-json out/reliability.json

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(VENV)/.installed
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs out/docs
	@echo "open out/docs/index.html"

# Every script in benchmarks/, one after the other; make bench QUICK=--quick for small runs.
bench: $(VENV)/.installed
	@mkdir -p $(BENCH_OUT)
	@failed=; for script in $$(grep -l '^if __name__ == "__main__":' benchmarks/*.py); do \
	  name=$$(basename $$script .py); echo "== $$name"; \
	  $(BIN)/python $$script $(QUICK) --json $(BENCH_OUT)/$$name.json --out $(BENCH_OUT)/$$name || failed="$$failed $$name"; \
	done; test -z "$$failed" || { echo "failed:$$failed"; exit 1; }

# Chromium, for the tests of what a browser shows; they are skipped without it.
browser:
	@command -v chromium >/dev/null || command -v google-chrome >/dev/null || { \
	  command -v apt-get >/dev/null && [ "$$(id -u)" = 0 ] || { echo "install Chromium to test the viewer"; exit 1; }; \
	  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends chromium; }

clean:
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
