# Names for the common commands. Each sets up the machine first when needed.
# PRESET=debug, asan or tsan builds and tests another configuration;
# ARGS="..." goes to the program that demo and bench run.

PRESET ?= release
JOBS ?= $(shell nproc)
BUILD := $(if $(filter release,$(PRESET)),build,build-$(PRESET))
PYTHON := .venv/bin/python
# What runs with a sanitizer is in scripts/sanitizers.py.
KINDS := $(if $(filter asan tsan,$(PRESET)),--sanitizer $(PRESET))

.DEFAULT_GOAL := help
.PHONY: help build demo test test-gpu test-layouts test-bounds test-differential fuzz fuzz-sparse stress paper soak coverage deb bench bench-error bench-error-gate bench-pairs bench-regress fmt lint tidy portable wheel docs site clean setup check peers test-peers

help: ## list these commands
	@grep -hE '^[a-z-]+:.*## ' Makefile | sed -E 's/^([a-z-]+):.*## /\1\t/' | \
	  while IFS="$$(printf '\t')" read -r name text; do printf '  make %-17s %s\n' "$$name" "$$text"; done

setup: ## install system packages and make .venv (the others call it)
	@scripts/setup.sh

peers: setup ## install pyright, torch, JAX, Warp and Taichi, which some tests use and else skip
	@.venv/bin/pip install --quiet -r scripts/requirements-peers.txt

build: setup ## configure and compile everything
	@test -f $(BUILD)/build.ninja || cmake --preset $(PRESET)
	@ninja -C $(BUILD) -j$(JOBS)

demo: build ## optimise a mass-spring triangle by gradients, and draw it
	@$(PYTHON) examples/mass_spring_simple.py $(ARGS)

test: build ## run lit, GoogleTest, pytest and the style checks
	@$(PYTHON) scripts/run_tests.py --build $(BUILD) --jobs $(JOBS) $(KINDS)

check: build ## run a part of all tests that has something of every room, in about 3 minutes
	@$(PYTHON) scripts/run_tests.py --build $(BUILD) --jobs $(JOBS) --quick

# Runs where no LLVM is: from the bundle in dist/, with the Python of the machine.
test-gpu: ## test and time the portable bundle on a GPU (ARGS="--tests -k smoke")
	@$(or $(wildcard $(PYTHON)),python3) scripts/test_gpu.py $(ARGS)

test-peers: build peers ## run programs of other libraries beside ours, and share tensors with them
	@$(PYTHON) -m pytest -q -rs --tb=short -n $(JOBS) test/python/tools/test_other_libraries.py test/python/interop $(ARGS)

test-layouts: build ## run the tests of kernels on every layout, and compare
	@$(PYTHON) scripts/run_tests.py --build $(BUILD) --jobs $(JOBS) --layouts

test-bounds: build ## run the Python tests with bounds="check": the same results
	@TI_BOUNDS=check $(PYTHON) -m pytest -q --tb=short -n $(JOBS) test/python $(ARGS)

test-differential: build ## run examples and scenes in all ways, at larger sizes, and compare
	@$(PYTHON) -m pytest -q --tb=short -n $(JOBS) --long --timeout 0 test/python/integration/test_differential.py $(ARGS)

fuzz: build ## differentiate 5000 random kernels (ARGS="--count 500 --first 9000")
	@$(PYTHON) test/fuzz/run.py --jobs $(JOBS) --log $(BUILD)/fuzz.jsonl $(ARGS)
	@$(PYTHON) test/fuzz/run_updates.py --jobs $(JOBS) --log $(BUILD)/fuzz-updates.jsonl

fuzz-sparse: build ## play 10000 random sequences on random sparse trees (ARGS="--first 900")
	@$(PYTHON) test/fuzz/run_sparse.py --jobs $(JOBS) --log $(BUILD)/fuzz-sparse.jsonl $(ARGS)

stress: build ## run the 44 stress cases at full size, with what they measure (ARGS="--only S22")
	@$(PYTHON) scripts/stress.py $(ARGS)

paper: build ## rerun the figures and tables of the paper into out/paper (ARGS="--full")
	@$(PYTHON) -m tai paper $(ARGS)

soak: build ## run the bars of reliability, 90 minutes (ARGS="--only R5 R8"): docs/reliability.md
	@$(PYTHON) test/reliability/soak.py $(ARGS)

coverage: build ## count the lines and branches that tests run (ARGS="--only python")
	@$(PYTHON) scripts/measure_coverage.py --jobs $(JOBS) $(ARGS)

bench: build ## time the scenes against other systems: CSV and plot
	@$(PYTHON) benchmarks/run.py $(ARGS)
	@$(PYTHON) benchmarks/programs/run.py
	@$(PYTHON) benchmarks/sparse/run.py

bench-error: build ## run time against error in all modes: docs/reports/accuracy.md (ARGS=--quick)
	@$(PYTHON) benchmarks/error/run.py $(ARGS)

bench-error-gate: build ## compare errors and times with another build (ARGS=/path/to/base)
	@$(PYTHON) benchmarks/error/compare.py $(ARGS)

bench-pairs: build ## time this build and another one in turns (ARGS="/path/to/base")
	@$(PYTHON) benchmarks/pairs.py $(ARGS)

bench-regress: build ## compare programs and forms with another build in turns (ARGS="/path/to/base")
	@$(PYTHON) benchmarks/zoo/regress.py $(ARGS)

bench-sparse: build ## time sparse layouts against dense ones (ARGS="--rounds 3")
	@$(PYTHON) benchmarks/sparse/run.py $(ARGS)

fmt: setup ## format C++ and Python
	@$(PYTHON) scripts/lint.py --fix

lint: setup ## check the format and the style of C++ and Python
	@$(PYTHON) scripts/lint.py

tidy: build ## clang-tidy over changed sources and headers (ARGS=--all); needs clang-tidy-22
	@$(PYTHON) scripts/tidy.py --build $(BUILD) --jobs $(JOBS) $(ARGS)

portable: setup ## make dist/tai-portable-*.tar.xz, which needs no LLVM to run
	@scripts/portable.sh $(JOBS)

deb: build ## make Debian packages in dist/, for machines with LLVM and MLIR 22
	@cd $(BUILD) && SOURCE_DATE_EPOCH=$${SOURCE_DATE_EPOCH:-$$(git log -1 --format=%ct)} cpack -G DEB

wheel: setup ## make wheels of all CPythons that are found, an sdist, an SBOM (ARGS=--download)
	@scripts/portable.sh $(JOBS)
	@$(PYTHON) scripts/make_wheels.py $(ARGS)

docs: build ## generate the reference of dialect and passes in build/docs
	@ninja -C $(BUILD) mlir-doc
	@echo "the reference is in $(BUILD)/docs/reference"

site: build ## build the documentation site, with search and checked links: build/site
	@BUILD=$(BUILD) scripts/site/build.sh

clean: ## remove what was built (.venv stays)
	rm -rf build build-debug build-asan build-tsan build-coverage build-mutants build-portable dist python/tai/_core*.so
