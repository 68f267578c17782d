# RenderFlow. `make demo` and `make test` do all set-up on a fresh Debian or Ubuntu with Rust and Python's pip.
.PHONY: demo test test-full bench docs oidn build lint hdri clean

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
	$(CARGO) test --release --workspace

# What takes longer, or needs packages from the Python registry.
test-full: test build
	$(CARGO) test --release --workspace -- --ignored
	sh tests/python/run.sh
	sh tests/slurm/run.sh
	sh tests/browser/run.sh
	$(RENDERFLOW) stress --again --out target/stress.json

# Time against error on every benchmark scene, small: minutes. docs/benchmarks.md has the other measurements.
bench: oidn
	$(CARGO) build --release -p renderflow-bench
	target/release/renderflow-bench convergence --resolution 128 --max-spp 64 --repeats 1 --reference-spp 1024 --out bench

# The book, target/book/index.html. mdBook is built once, into target/tools.
MDBOOK = target/tools/bin/mdbook
$(MDBOOK):
	$(CARGO) install mdbook --version 0.5.4 --locked --no-default-features --features search --root target/tools

docs: $(MDBOOK)
	$(MDBOOK) build docs

# Fetches Intel Open Image Denoise; without it everything works and pictures stay noisy.
oidn:
	@sh scripts/fetch_oidn.sh || echo "warning: OIDN could not be fetched; pictures stay noisy without it"

# The maps of hdri/ again, bit for bit.
hdri: build
	$(RENDERFLOW) hdri --out hdri --overwrite

clean:
	$(CARGO) clean
	rm -rf demo-out
