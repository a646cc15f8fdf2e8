# Everything goes into .venv; needs a Rust toolchain, Python 3.9+ and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CORE := core/Cargo.toml Cargo.toml Cargo.lock $(wildcard core/src/*.rs)
DEM := sample_dem/jacksboro.dem

.PHONY: demo test test-rust test-python lint clean

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
	$(BIN)/maturin develop --release --quiet --extras test,lint,bench
	touch $@

demo: $(VENV)/installed
	mkdir -p out
	$(BIN)/dem2tin $(DEM) out/jacksboro.gpkg out/jacksboro.obj out/jacksboro.tif --overwrite --json out/jacksboro.json

test: test-rust test-python

test-rust:
	cargo test --release --quiet

test-python: $(VENV)/tools
	$(BIN)/python -m pytest

lint: $(VENV)/tools
	cargo fmt --all --check
	cargo clippy --release --all-targets --all-features -- -D warnings
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean:
	rm -rf $(VENV) target out dist
