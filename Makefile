# make demo          write a video of a figure that gestures to examples/hello.wav, out/demo.mp4
# make test          run the tests
# make test-all      run them with damaged files, the commands of the pages, a cluster and further networks
# make fuzz          give every reader damaged files, for an hour (FUZZ_SECONDS)
# make test-torch    compare the numerics with PyTorch
# make test-blender  test exports and the add-on in Blender (its wheel needs Python 3.11)
# make test-web      test ha2g-web, the pages in Chromium, and exports with the validator of Khronos (needs node and chromium)
# make web           write a site that runs the demo in browsers, out/site (needs node and npm)
# make pose          install the environment of the pose estimator in the user's cache
# make lint          check style, types and the direction of imports
# make docs          build the documentation, out/docs/index.html; a broken link or anchor is an error
# make release       write what a release publishes, dist/: wheel, sources, npm package, extension for Blender
# make notebooks     run the notebooks and store their output
# make clean         remove the environments, out/ and caches

PYTHON ?= python3
VENV ?= .venv
PYTEST_WORKERS ?= 3
TORCH_TESTS ?= torch
# Or "uv pip", which takes a quarter of the time and does not read the settings of pip.
INSTALLER ?= pip
PIP = -m pip install --quiet --no-compile
INSTALL = -m $(INSTALLER) install --quiet --no-compile
FUZZ_SECONDS ?= 3600

.PHONY: demo test test-all fuzz test-torch test-blender test-web web pose lint docs release notebooks clean

demo: $(VENV)/demo
	mkdir -p out
	$(VENV)/bin/ha2g generate examples/hello.wav --out out/demo

test: $(VENV)/test
	$(VENV)/bin/python -m pytest -n $(PYTEST_WORKERS) --dist worksteal -m "not thorough"

test-all: $(VENV)/test
	$(VENV)/bin/python -m pytest -n $(PYTEST_WORKERS) --dist worksteal

fuzz: $(VENV)/test
	@end=$$(( $$(date +%s) + $(FUZZ_SECONDS) )); while [ $$(date +%s) -lt $$end ]; do \
		HA2G_FUZZ_EXAMPLES=500 $(VENV)/bin/python -m pytest -n $(PYTEST_WORKERS) tests/fuzz || exit 1; \
	done

# With AVX-512, the oneDNN of PyTorch 2.13 writes past its memory in a training step on some AMD processors.
test-torch: $(VENV)-torch/torch
	ONEDNN_MAX_CPU_ISA=AVX2 $(VENV)-torch/bin/python -m pytest -m $(TORCH_TESTS) $$(grep -rl 'mark\.torch' tests --include='test_*.py')

test-blender: $(VENV)/test $(VENV)-blender/bpy
	HA2G_BLENDER_PYTHON=$(abspath $(VENV))-blender/bin/python $(VENV)/bin/python -m pytest tests/test_blender.py tests/motion/formats tests/motion/readers

test-web: $(VENV)/test $(VENV)-web/node_modules integrations/web/node_modules
	npm test --silent --prefix integrations/web
	NODE_PATH=$(abspath $(VENV))-web/node_modules:$(abspath integrations/web)/node_modules $(VENV)/bin/python -m pytest tests/viewer tests/motion/formats tests/apps/live tests/apps/web tests/apps/user_study

web: $(VENV)/onnx
	$(VENV)/bin/ha2g web demo --out out/site

pose: $(VENV)/demo
	$(VENV)/bin/ha2g data build-video --install

lint: $(VENV)/test $(VENV)/lint
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/lint-imports
	$(VENV)/bin/pyrefly check --python-interpreter-path $(VENV)/bin/python --min-severity error

docs: $(VENV)/docs
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/mkdocs build --strict

release: $(VENV)/bin/python integrations/web/node_modules
	$(VENV)/bin/python $(INSTALL) build
	$(VENV)/bin/python -m build --outdir dist
	npm run --silent build --prefix integrations/web
	cd integrations/web && npm pack --silent --pack-destination ../../dist
	$(VENV)/bin/python integrations/blender/build.py

notebooks: $(VENV)/notebook
	$(VENV)/bin/python notebooks/run.py

# One stamp file for each extra: it is installed once, and again when pyproject.toml changes.
$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python $(PIP) --upgrade $(firstword $(INSTALLER))

$(VENV)/demo: $(VENV)/bin/python pyproject.toml
	$(VENV)/bin/python $(INSTALL) --editable .
	touch $@

$(VENV)/test $(VENV)/onnx $(VENV)/notebook $(VENV)/docs $(VENV)/lint: $(VENV)/bin/python pyproject.toml
	$(VENV)/bin/python $(INSTALL) --editable '.[$(@F)]'
	touch $@

# It has PyTorch beside what the tests need, which is read from $(VENV).
$(VENV)-torch/torch: $(VENV)/test
	$(PYTHON) -m venv $(VENV)-torch
	cd $(VENV)-torch/lib/python*/site-packages && ls -d $(abspath $(VENV))/lib/python*/site-packages > test.pth
	$(VENV)-torch/bin/python $(PIP) --editable '.[torch]'
	$(VENV)-torch/bin/python $(PIP) --no-deps smplx  # for non-commercial research; tests alone compare with it
	touch $@

$(VENV)-blender/bpy:
	$(PYTHON) -m venv $(VENV)-blender
	$(VENV)-blender/bin/python $(PIP) bpy numpy
	touch $@

integrations/web/node_modules: integrations/web/package-lock.json
	npm ci --silent --no-audit --no-fund --ignore-scripts --prefix integrations/web
	touch $@

$(VENV)-web/node_modules:
	npm install --silent --no-audit --no-fund --prefix $(VENV)-web gltf-validator playwright-core axe-core @met4citizen/talkinghead

clean:
	rm -rf $(VENV) $(VENV)-torch $(VENV)-blender $(VENV)-web integrations/web/node_modules integrations/web/build integrations/web/dist out .cache build dist
