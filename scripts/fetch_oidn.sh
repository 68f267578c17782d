#!/bin/sh
# Fetches Intel Open Image Denoise 2.5.1 into .oidn/ of the repository: the shared libraries of the pyoidn package, checked
# against their hash. Does nothing, and needs no network, where they are already there. Linux x86_64.
set -eu

cd "$(dirname "$0")/.."
wheel=pyoidn-2.5.1.0-py3-none-manylinux2014_x86_64.whl
sha256=32ad13368f8de1ef63001942ad05b02a00cd732d1206d97f352d3a3f606d823e
root=.oidn/pyoidn/oidn
# Written last, so that an interrupted run is not taken for a finished one.
stamp=.oidn/$sha256

if [ -f "$stamp" ] && [ -f "$root/lib/libOpenImageDenoise.so.2" ]; then
    exit 0
fi

case "$(uname -s)-$(uname -m)" in
Linux-x86_64) ;;
*)
    echo "fetch_oidn: no packaged OIDN for $(uname -s) on $(uname -m); name an installed OIDN 2 with RENDERFLOW_OIDN instead" >&2
    exit 1
    ;;
esac

python=${PYTHON:-python3}
if ! $python -m pip --version >/dev/null 2>&1; then
    echo "fetch_oidn: python3 with pip is needed (Debian: apt-get install python3-pip)" >&2
    exit 1
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
trap 'exit 1' INT TERM

echo "fetch_oidn: downloading Open Image Denoise 2.5.1 (88 MB)" >&2
echo "pyoidn==2.5.1.0 --hash=sha256:$sha256" >"$work/requirements.txt"
$python -m pip download -q --disable-pip-version-check --no-deps --only-binary :all: --platform manylinux2014_x86_64 \
    --require-hashes -r "$work/requirements.txt" -d "$work"
echo "$sha256  $work/$wheel" | sha256sum -c - >/dev/null

$python -m zipfile -e "$work/$wheel" "$work/unpacked"
rm -rf .oidn/pyoidn
# Only what the CPU device needs, 54 of 171 MB. The folder must be called lib: the libraries find each other through it.
mkdir -p "$root/lib"
for library in libOpenImageDenoise.so.2 libOpenImageDenoise_core.so.2.5.1 libOpenImageDenoise_device_cpu.so.2.5.1 libtbb.so.12; do
    cp "$work/unpacked/pyoidn/oidn/lib/$library" "$root/lib/"
done
: >"$stamp"
echo "fetch_oidn: ready in $root" >&2
