# `make demo` and `make test` need Python 3.11 or later and nothing else: each makes the environment it uses.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
WORKERS ?= 2
# A file of versions to install, such as .ci/constraints.txt; by default the newest that pyproject.toml allows.
CONSTRAINTS ?=
INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check $(if $(CONSTRAINTS),-c $(CONSTRAINTS))

# A wheel for the CPU, of 200 MB; with a GPU give the ordinary one, TORCH=torch.
TORCH ?= torch==2.13.0+cpu

.PHONY: demo test test-long test-torch coverage lint types docs lock clean

demo: $(VENV)/.installed
	$(BIN)/skat demo

# One thread for linear algebra: that of one worker would wait for that of the others. Tests are compiled once, and
# not by every worker. The order is drawn anew each time; the first line of the output has its seed, and
# `make test SEED=...` repeats it.
PYTEST = PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 MPLBACKEND=agg $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal $(if $(SEED),-p randomly --randomly-seed=$(SEED))

test: $(VENV)/.installed-test
	$(PYTEST) -m "not long"

test-long: $(VENV)/.installed-test
	$(PYTEST) -m long

# Transports of tensors, in an environment of its own above the other; nothing is run where there is no such wheel.
test-torch: $(VENV)/.installed-test
	if [ ! -e $(VENV)-torch/.installed ]; then \
	    rm -rf $(VENV)-torch && $(BIN)/python -m venv --without-pip $(VENV)-torch && \
	    $(BIN)/python -c 'import sysconfig; print("import site; site.addsitedir(%r)" % sysconfig.get_path("purelib"))' \
	        > "$$($(VENV)-torch/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/above.pth" && \
	    timeout 240 $(VENV)-torch/bin/python -m pip install --quiet --disable-pip-version-check "$(TORCH)" && \
	    touch $(VENV)-torch/.installed || \
	    { echo "SKIPPED: $(TORCH) cannot be had here, so no test of tensors ran."; exit 0; }; \
	fi; \
	SCIPY_ARRAY_API=1 OMP_NUM_THREADS=1 $(VENV)-torch/bin/python -m pytest -k "torch or cuda" \
	    tests/transport/test_array_api.py tests/transport/test_model_selection.py

# Fails below the share of lines that pyproject.toml asks for.
coverage: $(VENV)/.installed-test
	$(PYTEST) -m "not long" --cov --cov-report=term

lint: $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed-test
	$(BIN)/mypy

docs: $(VENV)/.installed-docs
	$(BIN)/sphinx-build -W --keep-going -b html docs docs/_build/html
	$(BIN)/python docs/check_links.py docs/_build/html

$(BIN)/python:
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'skat needs Python 3.11 or later; this is ' + sys.version.split()[0] + '. Say which to use: make PYTHON=python3.11')"
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(BIN)/python pyproject.toml
	$(INSTALL) -e .
	touch $@

$(VENV)/.installed-test: $(VENV)/.installed
	$(INSTALL) -e ".[test]"
	touch $@

$(VENV)/.installed-docs: $(VENV)/.installed
	$(INSTALL) -e ".[docs]"
	touch $@

# Writes anew which versions CI installs; needs uv.
lock:
	uv pip compile --quiet --universal --upgrade --python-version 3.11 --extra test --extra docs --no-header --no-annotate pyproject.toml -o .ci/constraints.txt

clean:
	rm -rf $(VENV) $(VENV)-torch docs/_build docs/generated docs/gallery .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage
