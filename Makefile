# Each target makes the virtual environment and installs what it needs by itself: git, make and Python >= 3.10 suffice.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out/demo
BENCH_OUT ?= out/bench
# Processes that tests run in: 2, or auto for one per core. One more than cores took longer.
WORKERS ?= auto
MUTANTS ?= 60

# Compiled modules are kept, whatever the environment says: the tests start many processes.
PYTEST = env -u PYTHONDONTWRITEBYTECODE OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n $(WORKERS) --dist worksteal
SANITIZED := build/sanitized

.PHONY: demo check quick test test-nightly lint core sanitize mutation docs bench tables pictures browser clean \
  environments lowest newest no-compiler release wheel extras import

SOURCES := pyproject.toml CMakeLists.txt $(wildcard coopqp/core/*.cpp coopqp/core/*.h coopqp/core/*/*.cpp \
  coopqp/core/*/*.h coopqp/core/*.py)
# Make a virtual environment, and install into it.
define install
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "coopqp needs Python >= 3.10: make PYTHON=python3.x ...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check
endef

$(VENV)/.installed: $(SOURCES)
	$(install) --editable '.[dev]'
	touch $@

# What the demo needs: the package, whose core is compiled in half the time: once, for any processor, and optimised less.
$(VENV)/.demo: export SKBUILD_CMAKE_DEFINE := COOPQP_AVX2=OFF;CMAKE_CXX_FLAGS_RELEASE=-O1 -DNDEBUG
$(VENV)/.demo: $(SOURCES)
	$(install) --no-compile --editable .
	touch $@

demo: $(if $(wildcard $(VENV)/.installed),$(VENV)/.installed,$(VENV)/.demo)
	$(BIN)/coopqp demo --force --out $(OUT)

# After every edit: lint and types, and beside them every test that is not marked slow, properties with a tenth of their
# examples.
# pytest --durations 20 -m "not slow" shows what deserves the mark.
check: $(VENV)/.installed
	@$(MAKE) --no-print-directory --jobs 2 lint quick

quick: $(VENV)/.installed
	HYPOTHESIS_PROFILE=check $(PYTEST) -m "not slow"

# Before every commit: all tests, about half an hour on two slow cores.
test: $(VENV)/.installed
	@mkdir -p out
	$(PYTEST) --reliability-json=out/reliability.json

# The catalogue of docs/reliability.md with ten times the cases, random ones each time; hours.
test-nightly: $(VENV)/.installed
	@mkdir -p out
	HYPOTHESIS_PROFILE=nightly $(PYTEST) tests/reliability --timeout 36000 --reliability-json=out/reliability.json

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The compiled core, each warning an error, no weak symbol common to its two builds, and no heap in its arithmetic.
core: $(VENV)/.installed
	$(BIN)/cmake -S . -B build/strict -DCOOPQP_WERROR=ON -DPython_EXECUTABLE=$(CURDIR)/$(BIN)/python
	$(BIN)/cmake --build build/strict --clean-first --parallel 2
	$(BIN)/python .ci/weak_symbols.py build/strict

# The tests marked core in a copy of the package whose core stops at the first wrong access to memory and the first
# undefined operation. The lines before them make sure that it is this core that the tests get. Eight tests are skipped:
# they compare roundings of cores that are compiled alike.
# SOME="and not slow" leaves slow tests out, too. The arithmetic is compiled once: with AVX2 it is the same code.
sanitize: export PYTHONPATH := $(CURDIR)/tests/elsewhere:$(CURDIR)/$(SANITIZED)/tree
sanitize: export ASAN_OPTIONS := detect_leaks=0
sanitize: export UBSAN_OPTIONS := print_stacktrace=1
sanitize: export COOPQP_MOST_SKIPS := 8
sanitize: $(VENV)/.installed
	$(BIN)/cmake -S . -B $(SANITIZED) -DCMAKE_BUILD_TYPE=RelWithDebInfo -DCOOPQP_SANITIZE=ON -DCOOPQP_AVX2=OFF \
	  -DCMAKE_CXX_FLAGS_RELWITHDEBINFO="-O1 -g1" -DPython_EXECUTABLE=$(CURDIR)/$(BIN)/python
	$(BIN)/cmake --build $(SANITIZED) --parallel 2
	rm -rf $(SANITIZED)/tree && mkdir $(SANITIZED)/tree && cp -r coopqp $(SANITIZED)/tree
	rm -f $(SANITIZED)/tree/coopqp/core/_core*.so
	$(BIN)/cmake --install $(SANITIZED) --prefix $(SANITIZED)/tree
	grep -q __asan_init $(SANITIZED)/tree/coopqp/core/_core*.so
	export LD_PRELOAD="$$(cc -print-file-name=libasan.so) $$(cc -print-file-name=libstdc++.so.6)" PYTHONMALLOC=malloc; \
	(cd $(SANITIZED) && $(CURDIR)/$(BIN)/python -c \
	  'from coopqp.core import _core as n; assert "$(SANITIZED)/tree" in n.__file__, n.__file__') && \
	$(PYTEST) -m "core $(SOME)" --capture sys -p no:cacheprovider

# Would a test fail if the code said something else? MUTANTS in each package and in the C code: hours; 5 for a look.
mutation: $(VENV)/.installed
	@mkdir -p out
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[mutation]'
	$(BIN)/python tests/mutation.py --number $(MUTANTS) --json benchmarks/data/mutation.json --resume

# Fresh environments below build/environments: the lowest versions, and the newest with a wheel from the source
# distribution, with all tests; a compiler from the index with some of make check; the wheels of a release and each extra alone with
# tests/installed.py. SOME=--some leaves slow tests out everywhere.
environments: $(VENV)/.installed
	$(BIN)/python .ci/environments.py $(SOME)

lowest newest no-compiler: $(VENV)/.installed
	$(BIN)/python .ci/environments.py $@ $(SOME)

# Wheels for every Python at hand, by the steps of the release, each tested; nothing is published.
release: $(VENV)/.installed
	$(BIN)/python .ci/environments.py release

wheel: $(VENV)/.installed
	$(BIN)/python .ci/environments.py from-sdist

extras: $(VENV)/.installed
	$(BIN)/python .ci/environments.py extras

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

# Every picture of the README and of docs, drawn anew by the programs that docs/pictures.py lists.
pictures: $(VENV)/.installed
	$(BIN)/python docs/pictures.py

# The measured tables of the pages, on a machine with nothing else to do. PlaCo is installed beside, if it can be.
tables: $(VENV)/.installed
	@mkdir -p $(BENCH_OUT)
	$(BIN)/python benchmarks/behaviour.py --cases fast limit mismatch --json $(BENCH_OUT)/behaviour.json
	$(BIN)/python benchmarks/compare_peers.py --peers placo --arms 3 8 16 --cases nominal measured watched qp zigzag \
	  --json $(BENCH_OUT)/compare_peers.json
	$(BIN)/python benchmarks/promises.py --group chain --json $(BENCH_OUT)/promises.json
	$(BIN)/python docs/tables.py $(BENCH_OUT)

# Chromium, for the tests of what a browser shows; they are skipped without it.
browser:
	@command -v chromium >/dev/null || command -v google-chrome >/dev/null || { \
	  command -v apt-get >/dev/null && [ "$$(id -u)" = 0 ] || { echo "install Chromium to test the viewer"; exit 1; }; \
	  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends chromium; }

clean:
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
