#!/bin/sh
# Runs one target for a number of minutes, going on after a finding: fuzz/run.sh TARGET [MINUTES] [BINARY FOLDER]
# Findings lie in fuzz/artifacts/TARGET, new inputs in fuzz/corpus/TARGET; fuzz/corpus/TARGET.log has the log of this and earlier runs, of which
# fuzz/total.sh makes a table. TIMEOUT is the seconds an input may take; a busy machine needs more than 5.
set -eu
target=$1
minutes=${2:-20}
cd "$(dirname "$0")"
binaries=${3:-target/x86_64-unknown-linux-gnu/release}
RENDERFLOW_FUZZ_DIR=$(mktemp -d -p "$([ -d /dev/shm ] && echo /dev/shm || echo /tmp)")
export RENDERFLOW_FUZZ_DIR
trap 'rm -rf "$RENDERFLOW_FUZZ_DIR"' EXIT
mkdir -p "corpus/$target" "artifacts/$target"
# Memory that was freed must not count: 16 MB of it are kept for finding uses after free.
export ASAN_OPTIONS=quarantine_size_mb=16:allocator_may_return_null=0:detect_leaks=0
# One thread: inputs are small, and rayon's others would only wait.
export RAYON_NUM_THREADS=1
dictionary=dictionaries/$target.dict
[ -f "$dictionary" ] && dictionary="-dict=$dictionary" || dictionary=
end=$(($(date +%s) + 60 * minutes))
while left=$((end - $(date +%s))); [ "$left" -gt 1 ]; do
    status=0
    # shellcheck disable=SC2086
    "$binaries/$target" $dictionary -max_total_time=$left -rss_limit_mb=1024 -malloc_limit_mb=1000 -timeout="${TIMEOUT:-5}" \
        -print_final_stats=1 -max_len=16384 -artifact_prefix="artifacts/$target/" "corpus/$target" "seeds/$target" \
        >> "corpus/$target.log" 2>&1 || status=$?
    # Time is over, or somebody interrupted it; anything else is a finding.
    case $status in 0 | 72) break ;; esac
done
grep -E "^SUMMARY|ERROR: libFuzzer|ERROR: AddressSanitizer" "corpus/$target.log" || true
./total.sh "$target"
