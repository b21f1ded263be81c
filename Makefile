# From a fresh clone: `make car` renders a point cloud, `make test` runs the tests.
# Needs python3 (3.11 or newer, with venv), make and a Python package index; nothing else.

PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
SYNC := UV_PROJECT_ENVIRONMENT=.venv $(BIN)/uv sync --quiet --locked --inexact --python $(BIN)/python

.PHONY: car test quick test-gpu fuzz test-all lint docs format bench bench-check lock release clean
.DELETE_ON_ERROR:

# Without what Python keeps of a compiled module, each of some 200 starts compiles all libraries anew.
unexport PYTHONDONTWRITEBYTECODE

car: $(READY)
	@mkdir -p out
	$(BIN)/lidarscene render scenes/car.toml -o out/car.ply --picture out/car.png \
	    --set scanner.azimuth_step_deg=0.1 --set scanner.elevation_step_deg=0.1

# Three workers for two cores: some tests wait for processes, disks and browsers.
test: $(READY)
	$(BIN)/pytest -n 3 --dist loadfile --no-loadscope-reorder $(PYTEST_ARGS)

# Half of the tests, of every folder, and more of what differs from the last commit, in about a minute: tests/costly, which
# tools/costs.py writes, names the others.
quick: $(READY)
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder -q -x --part=quick $(PYTEST_ARGS)

# The suite on an NVIDIA GPU, without what no device touches. The frame before it says in a line what is amiss without
# one, where tests would be skipped. Processes share the card. EMULATED=1: on an emulated one, which is the CPU.
GPU_WORKERS ?= $(if $(EMULATED),2,8)
ON_CARD = LIDARSCENE_VARIANT=cuda_ad_mono $(if $(EMULATED),$(BIN)/python tests/emulated_gpu/emulator.py)
test-gpu: $(READY)
	@mkdir -p out
	$(ON_CARD) $(BIN)/lidarscene render car --sensor vlp-16 -o out/gpu.ply
	$(ON_CARD) $(BIN)/pytest -n $(GPU_WORKERS) --dist loadfile --no-loadscope-reorder -q \
	    tests/kernel tests/rendering tests/chain tests/detection tests/light tests/scan tests/scene tests/outputs \
	    tests/cloud tests/studies tests/validation tests/sensor tests/figures tests/labels $(PYTEST_ARGS)

# Spoilt files and command lines: thousands, from any seed, with the frames of those that can be traced.
N ?= 5000
SEED ?= 1
fuzz: $(READY)
	FUZZ_INPUTS=$(N) FUZZ_SEED=$(SEED) FUZZ_PARTS=10 FUZZ_TRACED=1 $(BIN)/pytest -n 2 -q tests/fuzz/test_fuzz.py
	FUZZ_SENSORS=500 FUZZ_SEED=$(SEED) $(BIN)/pytest -n 0 -q tests/fuzz/test_sensors_in_turn.py

# The tests of kernels run once more with kernels as users have them: the suite compiles without optimisation.
test-all: export EVERY_CASE = 1
test-all: test
	TEST_OPTIMISED_KERNELS=1 $(BIN)/pytest -n 3 --dist loadfile -q tests/kernel tests/detection tests/light tests/chain
	ENDURANCE=1 $(BIN)/pytest -n 0 tests/fuzz/test_endurance.py
	$(BIN)/python tools/environments.py wheel lowest newest

lint: $(READY)
	$(BIN)/uv lock --check
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "wrote out/site/index.html"

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(READY)
	$(BIN)/python benchmarks/run.py

bench-check: $(READY)
	$(BIN)/pytest -n 0 benchmarks

# What is published: sdist and wheel in dist/, checked, and the site in out/site. Nothing is uploaded.
release: $(READY) docs
	$(BIN)/python tools/release.py

lock: $(READY)
	$(BIN)/uv lock --upgrade

clean:
	rm -rf .venv out build dist .hypothesis .pytest_cache .mypy_cache .ruff_cache

# The environment, made again only when what it is made from has changed.
# uv stays in it (--inexact), and takes this Python and no other (--python).
$(READY): pyproject.toml uv.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	    echo "make: lidarscene needs Python 3.11 or newer, and '$(PYTHON)' is not:" \
	         "try make PYTHON=python3.12" >&2; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check "uv>=0.5"
	@$(SYNC) || { echo "make: once more without open3d, which is optional and has no wheel for every system" >&2; \
	    $(SYNC) --no-install-package open3d --no-install-package libusb-package; }
	@touch $@
