# Every verb sets up what it needs first: `make demo` works on a machine that has Python >= 3.11 and
# make. Options: PYTHON=python3.12, VENV=folder, TORCH_INDEX=address of other builds of torch.

VENV ?= .venv
INSTALL ?= -e .[dev]
TESTS ?= tests
export PYTHON TORCH_INDEX

READY := $(VENV)/.ready
BIN := $(VENV)/bin

.PHONY: help demo test test-fast fuzz lint bench format assets wheel clean

help:
	@echo "make demo    one scene, two views, a pose before and after; writes demo.png"
	@echo "make test    the test suite"
	@echo "make test-fast  its tests that take seconds: under two minutes"
	@echo "make fuzz    damaged files for every reader, for an hour"
	@echo "make lint    ruff, mypy, and that imports point down"
	@echo "make bench   times our work against alternatives; writes bench.json"
	@echo "make format  lets ruff rewrite what it can"
	@echo "make assets  rebuilds the thirteen objects from their solids"
	@echo "make wheel   dist/two_view_pose-*.whl"
	@echo "make clean   removes what these made, the environment too"

demo: $(READY)
	$(BIN)/python -m two_view_pose demo

test: $(READY)
	$(BIN)/pytest $(TESTS)

test-fast: $(READY)
	$(BIN)/pytest -m "not slow" $(TESTS)

fuzz: $(READY)
	$(BIN)/python tests/fuzz

lint: $(READY) build/lint/two_view_pose
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	MYPYPATH=build/lint:tests $(BIN)/mypy -p benchmarks -m two_view_pose -m two_view_pose.__main__ \
	  -p two_view_pose.agents -p two_view_pose.assets -p two_view_pose.core \
	  -p two_view_pose.envs -p two_view_pose.pose_estimator
	PYTHONPATH=build/lint $(BIN)/lint-imports

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(READY)
	$(BIN)/python tests/benchmarks --json bench.json

assets: $(READY)
	$(BIN)/python -m two_view_pose.assets.build

# From a clean build folder, since setuptools packs whatever an earlier build left there.
wheel: $(BIN)/pip
	rm -rf build/lib build/bdist.* dist
	$(BIN)/pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir dist .

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .ruff_cache .mypy_cache demo.png

$(BIN)/pip:
	bash .ci/setup $(VENV)

$(READY): pyproject.toml requirements-lock.txt .ci/setup
	bash .ci/setup $(VENV) $(INSTALL)
	touch $@

# mypy wants to see the package under its name, which the checkout's folder does not bear.
build/lint/two_view_pose:
	mkdir -p build/lint
	ln -sfn ../.. $@
