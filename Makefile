# Everything goes into .venv; needs a Rust toolchain, Python 3.9+ and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CORE := core/Cargo.toml Cargo.toml Cargo.lock $(wildcard core/src/*.rs)
DEM := sample_dem/jacksboro.dem
PLUGIN_ZIP := dist/dem2tin_qgis.zip
# The Python that QGIS itself uses, never that of the virtual environment.
QGIS_PYTHON ?= /usr/bin/python3
QGIS_SITE := target/qgis-site

.PHONY: demo test test-rust test-python test-qgis pictures plugin lint fuzz fuzz-reader \
  bench-core instructions clean

FUZZ_SECONDS ?= 60
# The same files in every run of CI; any other number tries others.
FUZZ_SEED ?= 1
FUZZ_TARGETS := predicates insert constrain outline domain refine
FUZZ := target/fuzz
HOST = $(shell rustc -vV | sed -n 's/^host: //p')
# What cargo-fuzz passes but for the sanitisers, which need a nightly toolchain.
COVERAGE := -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
  -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
  -Cllvm-args=-sanitizer-coverage-trace-compares --cfg fuzzing

$(VENV)/ready: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip
	$(BIN)/pip install --quiet "maturin>=1.9,<2"
	touch $@

# The package with all that the command line needs.
$(VENV)/installed: $(VENV)/ready $(CORE)
	$(BIN)/maturin develop --release --quiet
	touch $@

$(VENV)/tools: $(VENV)/installed
	$(BIN)/maturin develop --release --quiet --extras test,bench
	touch $@

$(VENV)/linters: $(VENV)/tools
	$(BIN)/maturin develop --release --quiet --extras lint
	touch $@

demo: $(VENV)/installed
	mkdir -p out
	$(BIN)/dem2tin $(DEM) out/jacksboro.gpkg out/jacksboro.obj out/jacksboro.tif out/jacksboro.png --overwrite

test: test-rust test-python test-qgis

test-rust:
	cargo test --release --quiet

test-python: $(VENV)/tools
	$(BIN)/python -m pytest --ignore=tests/qgis -n auto --dist worksteal

# The QGIS plugin as the plugin repository takes it.
plugin:
	$(PYTHON) qgis_plugin/make_zip.py $(PLUGIN_ZIP)

# The core as QGIS gets it: the wheel alone, without the libraries of the command line.
$(QGIS_SITE)/ready: $(VENV)/installed $(shell find tin -name '*.py')
	rm -rf $(QGIS_SITE)
	$(BIN)/maturin build --release --quiet --out $(QGIS_SITE)/wheel
	$(BIN)/pip install --quiet --no-deps --target $(QGIS_SITE) $(QGIS_SITE)/wheel/*.whl
	touch $@

# In a real QGIS, with the system's Python; without QGIS on the machine there is nothing to test in.
test-qgis: $(VENV)/installed
	@if $(QGIS_PYTHON) -c "import qgis.core, pytest" 2>/dev/null; then \
	  $(MAKE) $(QGIS_SITE)/ready && \
	  PYTHONPATH=$(abspath $(QGIS_SITE)) DEM2TIN=$(abspath $(BIN)/dem2tin) QGIS_PICTURES=$(abspath out/qgis) \
	    $(QGIS_PYTHON) -m pytest tests/qgis -p no:cacheprovider; \
	elif [ -n "$(QGIS_REQUIRED)" ]; then \
	  echo "QGIS (python3-qgis) and python3-pytest are not on this machine" >&2; exit 1; \
	else echo "no QGIS on this machine: its tests are left out"; fi

# The screenshots of docs/qgis.md, made by the same tests.
pictures: $(VENV)/installed $(QGIS_SITE)/ready
	PYTHONPATH=$(abspath $(QGIS_SITE)) QGIS_PICTURES=$(abspath docs/images) \
	  $(QGIS_PYTHON) -m pytest tests/qgis/test_pictures.py -p no:cacheprovider

lint: $(VENV)/linters
	cargo fmt --all --check
	cargo clippy --release --all-targets --all-features -- -D warnings
	cargo fmt --manifest-path core/fuzz/Cargo.toml --check
	cargo clippy --release --manifest-path core/fuzz/Cargo.toml --target-dir $(FUZZ) -- -D warnings
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Each target for FUZZ_SECONDS from the committed corpus, which stays as it is; what is new and what is
# found goes to target/fuzz. The long run is: make fuzz FUZZ_SECONDS=600
fuzz: $(FUZZ_TARGETS:%=fuzz-%) fuzz-reader

$(FUZZ)/built: core/fuzz/Cargo.toml $(wildcard core/fuzz/src/*.rs core/fuzz/fuzz_targets/*.rs) $(CORE)
	RUSTFLAGS="$(COVERAGE)" cargo build --release --manifest-path core/fuzz/Cargo.toml \
	  --target $(HOST) --target-dir $(FUZZ)
	touch $@

fuzz-%: $(FUZZ)/built
	mkdir -p $(FUZZ)/new/$* $(FUZZ)/found/$*
	$(FUZZ)/$(HOST)/release/$* -max_total_time=$(FUZZ_SECONDS) -timeout=10 -max_len=512 -print_final_stats=1 \
	  -verbosity=0 -artifact_prefix=$(FUZZ)/found/$*/ $(FUZZ)/new/$* core/fuzz/corpus/$*

fuzz-reader: $(VENV)/installed
	$(BIN)/python tests/fuzz/reader.py --seed $(FUZZ_SEED) --seconds $(FUZZ_SECONDS) --found $(FUZZ)/found/reader

# Micro-benchmarks; some of them: make bench-core BENCH=scan. With BENCH="--save-baseline NAME" and later
# BENCH="--baseline NAME" the change is shown.
bench-core:
	cargo bench --bench micro -- $(BENCH)

# Instructions of a small fixed case against the budget of benchmarks/instructions.json; needs valgrind.
instructions:
	cargo build --release --quiet --example fixed_case
	$(PYTHON) benchmarks/instructions.py target/release/examples/fixed_case $(INSTRUCTIONS)

clean:
	rm -rf $(VENV) target out dist
