#!/bin/sh
# Packs the program for Linux on this kind of processor: target/dist/renderflow-VERSION-ARCH-linux.tar.gz and its checksum.
# The archive holds OIDN's libraries too, where `make oidn` fetched them; the program finds them in lib/ beside itself.
set -eu

cd "$(dirname "$0")/.."
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -1)
name=renderflow-$version-$(uname -m)-linux
folder=target/dist/$name
rm -rf target/dist
mkdir -p "$folder/completions"

cp target/release/renderflow README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE "$folder/"
cp docs/licences.md "$folder/LICENCES.md"
if [ -d .oidn/pyoidn/oidn/lib ]; then
    cp -rL .oidn/pyoidn/oidn/lib "$folder/lib"
fi
for shell in bash zsh fish; do
    target/release/renderflow completions $shell >"$folder/completions/renderflow.$shell"
done
target/release/renderflow man --out "$folder/man/man1"

# Equal inputs give equal bytes: names in order, no owners, one date.
date=@${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || echo 0)}
tar --sort=name --owner=0 --group=0 --numeric-owner --mtime="$date" -C target/dist -cf - "$name" | gzip -9n >"target/dist/$name.tar.gz"
(cd target/dist && sha256sum "$name.tar.gz" >"$name.tar.gz.sha256")
rm -rf "$folder"
ls -l target/dist
