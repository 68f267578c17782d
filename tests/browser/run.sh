#!/bin/sh
# Opens the report in headless Chromium and uses it by mouse, touch and keyboard. Screenshots stay in target/browser.
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
report=${1:-}
if [ -z "$report" ]; then
    report=$(mktemp -d)
    trap 'rm -rf "$report"' EXIT
    RENDERFLOW_REPORT_OUT=$report cargo test -q --release --test report pages_hold
fi
mkdir -p "$target/browser"
NODE_PATH=$modules/node_modules CHROMIUM=$chromium node tests/browser/report.cjs "$report" "$target/browser"
