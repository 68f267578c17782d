#!/bin/sh
# Opens the report and the viewer in headless Chromium and uses them by mouse, touch and keyboard. Screenshots stay in
# target/browser. MINUTES=30 adds as many minutes of random input to the viewer, and looks at the memory of the page.
set -eu
cd "$(dirname "$0")/../.."
target=${CARGO_TARGET_DIR:-target}
chromium=${CHROMIUM:-$(command -v chromium || command -v chromium-browser || command -v google-chrome || true)}
[ -n "$chromium" ] || { echo "skipped: there is no Chromium here"; exit 0; }
command -v npm >/dev/null || { echo "skipped: there is no Node.js here"; exit 0; }
modules=$target/browser-modules
if [ ! -d "$modules/node_modules/playwright-core" ]; then
    mkdir -p "$modules"
    npm install --silent --no-fund --no-audit --prefix "$modules" playwright-core@1.65.1 ||
        { echo "skipped: playwright-core cannot be installed here"; exit 0; }
fi
temporary=$(mktemp -d)
viewer=
trap 'rm -rf "$temporary"; [ -z "$viewer" ] || kill "$viewer"' EXIT
report=${1:-}
if [ -z "$report" ]; then
    report=$temporary/report
    mkdir "$report"
    RENDERFLOW_REPORT_OUT=$report cargo test -q --release --test report pages_hold
fi
mkdir -p "$target/browser"
export NODE_PATH=$modules/node_modules CHROMIUM=$chromium
node tests/browser/report.cjs "$report" "$target/browser"

# The viewer. Its first line of output is the address of the page.
address=$temporary/address
"$target/release/renderflow" view --seed 7 --resolution 512 > "$address" &
viewer=$!
for _ in $(seq 60); do
    [ -s "$address" ] && break
    sleep 1
done
node tests/browser/view.cjs "$(cat "$address")" "$target/browser" "${MINUTES:-0}"

