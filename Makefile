# RenderFlow. `make demo` and `make test` do all set-up on a fresh Debian or Ubuntu with Rust and Python's pip.
.PHONY: demo test test-full test-gpu check-cuda test-wheel bench docs oidn build dist wheel wheel-portable lint hdri clean

CARGO = cargo
RENDERFLOW = target/release/renderflow

build: oidn
	$(CARGO) build --release

# Pipeline on one held-out scene; ends with a table and demo-out/report/index.html.
demo: build
	$(RENDERFLOW) demo --out demo-out

lint:
	$(CARGO) fmt --all --check
	$(CARGO) clippy --release --workspace --all-targets -- -D warnings
	@if command -v cargo-deny >/dev/null; then cargo deny check; else echo "skipped: cargo deny is not installed"; fi

test: oidn
	$(MAKE) lint
	$(MAKE) check-cuda
	$(CARGO) test --release --workspace

# What takes longer, or needs packages from the Python registry.
test-full: test build test-wheel dist
	$(CARGO) test --release --workspace -- --ignored
	sh tests/python/run.sh
	sh tests/mpi/run.sh
	sh tests/slurm/run.sh
	python3 tests/readme/run.py
	sh tests/browser/run.sh
	sh tests/container/run.sh
	$(MAKE) docs
	$(CARGO) check --manifest-path fuzz/Cargo.toml --features all --target-dir target/fuzz-check
	$(RENDERFLOW) stress --again --out target/stress.json
	$(MAKE) test-gpu

# The types of the build for CUDA, without its tools: it cannot be linked without them.
check-cuda:
	DOCS_RS=1 $(CARGO) check --release -p renderflow-model --features cuda

# Networks on another device than the processor, which is OpenGL in software where there is no GPU. Afterwards $(RENDERFLOW) is a build
# for GPUs.
test-gpu:
	$(CARGO) test --release -p renderflow -p renderflow-model --features vulkan --test devices --test kernels --test fusion -- --nocapture

# Time against error on every benchmark scene, small: minutes. docs/benchmarks.md has the other measurements.
bench: oidn
	$(CARGO) build --release -p renderflow-bench
	target/release/renderflow-bench convergence --resolution 128 --max-spp 64 --repeats 1 --reference-spp 1024 --out bench

# The book with the references of Python and Rust, target/book/index.html; every link of the book and of the Python pages is followed
# (crates that ours use have broken links in the text that rustdoc takes from them). mdBook is built once, into target/tools.
MDBOOK = target/tools/bin/mdbook
$(MDBOOK):
	$(CARGO) install mdbook --version 0.5.4 --locked --no-default-features --features search --root target/tools

DOCS_PYTHON = target/docs-python/bin/python
$(DOCS_PYTHON):
	python3 -m venv target/docs-python
	$@ -m pip install -q "pdoc==16.0.0" "numpy>=1.26" || { rm -rf target/docs-python; exit 1; }

CRATES = renderflow renderflow-frame renderflow-scenes renderflow-renderer renderflow-model
docs: $(MDBOOK) $(DOCS_PYTHON)
	$(MDBOOK) build docs
	$(DOCS_PYTHON) scripts/python_api.py target/book/api/python
	$(CARGO) doc --lib --no-deps --locked $(CRATES:%=-p %)
	cp -r target/doc target/book/api/rust
	echo '<meta http-equiv="refresh" content="0; url=renderflow/index.html">' >target/book/api/rust/index.html
	$(DOCS_PYTHON) scripts/site.py target/book
	$(DOCS_PYTHON) scripts/check_links.py target/book --skip "api/rust/*"

# The Python wheel, target/wheels/renderflow-*.whl, and its tests in a fresh environment.
WHEEL_TOOLS = target/python-wheel
$(WHEEL_TOOLS)/bin/maturin:
	python3 -m venv $(WHEEL_TOOLS)
	$(WHEEL_TOOLS)/bin/pip install -q "maturin==1.16.0" "auditwheel==6.8.2"

wheel: $(WHEEL_TOOLS)/bin/maturin
	rm -rf target/wheels
	cd python && ../$(WHEEL_TOOLS)/bin/maturin build --release --out ../target/wheels
	$(WHEEL_TOOLS)/bin/auditwheel show target/wheels/*.whl

# A wheel for older systems, target/wheels-portable/*.whl: zig links it against glibc 2.28 (Debian 10, Ubuntu 18.10, RHEL 8), on
# whatever system it is built. It is a build of its own.
wheel-portable: $(WHEEL_TOOLS)/bin/maturin
	$(WHEEL_TOOLS)/bin/pip install -q "ziglang==0.17.1"
	rm -rf target/wheels-portable
	cd python && PATH="$(CURDIR)/$(WHEEL_TOOLS)/bin:$$PATH" ../$(WHEEL_TOOLS)/bin/maturin build --release --zig \
		--target x86_64-unknown-linux-gnu --compatibility manylinux_2_28 --out ../target/wheels-portable
	$(WHEEL_TOOLS)/bin/auditwheel show target/wheels-portable/*.whl

test-wheel: wheel
	sh python/tests/run.sh

# The program as an archive, target/dist/*.tar.gz, with its checksum.
dist: build
	sh scripts/dist.sh

# Fetches Intel Open Image Denoise; without it everything works and pictures stay noisy.
oidn:
	@sh scripts/fetch_oidn.sh || echo "warning: OIDN could not be fetched; pictures stay noisy without it"

# The maps of hdri/ again, bit for bit.
hdri: build
	$(RENDERFLOW) hdri --out hdri --overwrite

clean:
	$(CARGO) clean
	rm -rf demo-out
