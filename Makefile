# make demo: phases of a Blender scene and pictures of what they show, in out/demo; demo.png has it all at a glance
# make test: the tests, in minutes            make env: only what both need, in .venv
# make test-slow: those that take long, or compare with other people's programs (MINUTES=8: as many as begin in that time)
# make test-all: both, and those in the Blender that HOLOPATH_BLENDER names
# make test-cuda, make bench-cuda: tests of accuracy, and a full HD hologram by stages, on an NVIDIA card
# make lint, make bench; make docs: the documentation as a site, in build/site
# make guide: the parts of the documentation that the code declares: commands, settings, figures of the chart
# make extension: the zips that Blender installs, in dist; make repository: a folder that Blender updates from
# (ZIPS='--platform linux-x64 --python 3.13': one of them)
# make chart: speed against accuracy of all methods, in build/chart and docs; make chart-quick: part of it, in ten
# minutes, in build/chart/quick

VENV := .venv
PY := $(VENV)/bin/python
# Blender as a Python module exists for these versions only.
PYTHON ?= $(firstword $(foreach v,3.11 3.13,$(shell command -v python$(v) 2>/dev/null)))

RUN := $(VENV)/.holopath-run
DEV := $(VENV)/.holopath-dev
ORACLES := $(VENV)/.holopath-oracles
BPY_LIBRARIES := libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libice6 libgl1 libegl1
# Blender's API for the type checker; outside site-packages, where its bpy would shadow the real one.
BPY_STUBS := fake-bpy-module-5.0==20260730
PIP_INSTALL := $(PY) -m pip install --quiet --disable-pip-version-check

# A worker for each processor, as far as memory goes: each has Blender and Mitsuba loaded.
PYTEST_PARALLEL := $(PY) -m pytest --numprocesses auto --maxprocesses 8 --dist worksteal

# Those that compare what is computed with formulas, with Mitsuba's thin lens, with Cycles, and with LLVM.
CUDA_TESTS := tests/engine tests/export tests/stability tests/blender/test_demo.py tests/test_mitsuba_plugins.py tests/test_cuda.py

.PHONY: env demo test test-slow test-all test-cuda bench-cuda lint bench chart chart-quick extension repository docs guide clean

env: $(RUN) $(DEV)

$(PY):
	@test -n "$(PYTHON)" || { echo "make env: Python 3.11 or 3.13 is missing: install one, or name it with PYTHON=/path/to/python." >&2; exit 1; }
	@"$(PYTHON)" -c 'import ensurepip, venv' 2>/dev/null || { echo "make env: $(PYTHON) lacks the venv module: install it (Debian, Ubuntu: apt install python3-venv)." >&2; exit 1; }
	"$(PYTHON)" -m venv $(VENV)

# HoloPath, Blender as a module, and an LLVM (without a wheel of it, the system's or a graphics card must do).
$(RUN): pyproject.toml wheels.lock | $(PY)
	$(PIP_INSTALL) -e '.[blender]'
	@$(PY) -c 'import bpy' >$(VENV)/bpy.log 2>&1 || { echo "make env: Blender's Python module cannot be loaded ($$(tail -n 1 $(VENV)/bpy.log)): install the library that it names (Debian, Ubuntu: apt install $(BPY_LIBRARIES))." >&2; exit 1; }
	$(PY) -m distribution llvm || $(PY) -m holopath_addon devices
	@touch $@

# What tests, benchmarks and lint need besides.
$(DEV): pyproject.toml Makefile install_monitors.sh | $(RUN)
	$(PIP_INSTALL) -e '.[blender,test,docs]'
	$(PIP_INSTALL) --upgrade --no-deps --target $(VENV)/share/stubs $(BPY_STUBS)
	./install_monitors.sh
	@touch $@

# Other people's programs to compare with.
$(ORACLES): pyproject.toml | $(DEV)
	$(PIP_INSTALL) -e '.[blender,test,docs,oracles]'
	@touch $@

demo: $(RUN)
	$(PY) -m holopath_addon render demo:suzanne --resolution 512x512 --pitch 8 --frames 8 \
		--focus 0.5m,1m,4m --encode auto --encode-seconds 20 --contact-sheet demo.png --out out/demo

test: $(RUN) $(DEV)
	$(PYTEST_PARALLEL)

test-slow: $(RUN) $(DEV) $(ORACLES)
	$(PYTEST_PARALLEL) -m '(slow or oracle) and not dense and not blender' $(if $(MINUTES),--minutes $(MINUTES))

test-all: test test-slow
	@if [ -n "$$HOLOPATH_BLENDER" ]; then $(PY) -m pytest -m blender; fi

# On an NVIDIA card, and refused without one. One process: the card's memory is not shared out.
test-cuda bench-cuda: export HOLOPATH_BACKEND := cuda_ad_rgb

test-cuda: $(RUN) $(DEV)
	$(PY) -m pytest -m 'cuda or not (slow or oracle or dense or blender)' $(CUDA_TESTS)

bench-cuda: $(RUN) $(DEV)
	$(PY) -m benchmarks card

docs: $(DEV)
	$(PY) -m documentation site

guide: $(RUN)
	$(PY) -m documentation pages

lint: $(RUN) $(DEV)
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m pyrefly check
	$(PY) -m documentation words holopath_addon
	$(PY) -m codespell_lib holopath_addon tests benchmarks distribution documentation examples docs *.md

bench: $(RUN) $(DEV)
	$(PY) -m benchmarks

chart: $(RUN) $(DEV)
	$(PY) -m benchmarks chart --docs

chart-quick: $(RUN) $(DEV)
	$(PY) -m benchmarks chart quick

extension: $(DEV)
	$(PY) -m distribution extension $(ZIPS)

repository: $(DEV)
	$(PY) -m distribution repository $(ZIPS)

clean:
	rm -rf out build dist
