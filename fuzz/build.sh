#!/bin/sh
# Builds targets without cargo-fuzz, by the flags that it gives: fuzz/build.sh none|address [what cargo build takes, such as --bin exr]
# They lie in fuzz/target/none or fuzz/target/address. Any toolchain does: the flag of the sanitizer is not stable, hence the variable.
set -eu
sanitizer=$1
shift
cd "$(dirname "$0")"
coverage="-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 -Cllvm-args=-sanitizer-coverage-inline-8bit-counters \
    -Cllvm-args=-sanitizer-coverage-pc-table -Cllvm-args=-sanitizer-coverage-trace-compares -Cllvm-args=-simplifycfg-branch-fold-threshold=0"
RUSTFLAGS="$coverage --cfg fuzzing -Cdebug-assertions=on -Coverflow-checks=on -Ccodegen-units=1"
case $sanitizer in
    none) ;;
    address) RUSTFLAGS="$RUSTFLAGS -Zsanitizer=address" RUSTC_BOOTSTRAP=1 ;;
    *) echo "the first argument is none or address" >&2; exit 2 ;;
esac
export RUSTFLAGS
[ -z "${RUSTC_BOOTSTRAP:-}" ] || export RUSTC_BOOTSTRAP
# With a target named, build scripts and macros are built without these flags.
triple=$(rustc -vV | sed -n 's/^host: //p')
cargo build --release --target "$triple" --target-dir target/build/"$sanitizer" "$@"
mkdir -p target/"$sanitizer"
find target/build/"$sanitizer"/"$triple"/release -maxdepth 1 -type f -perm -u+x -exec cp -f {} target/"$sanitizer"/ \;
