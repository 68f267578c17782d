#!/bin/sh
# The archive, the wheel and the second stage of Dockerfile on a fresh Debian 12 without Rust and without this source, in a chroot.
# Prints the seconds from each installation to the first picture. Needs root and debootstrap; run `make dist wheel` first.
set -eu
cd "$(dirname "$0")/../.."
if [ "$(id -u)" != 0 ] || ! command -v debootstrap >/dev/null; then
    echo "skipped: a chroot needs root and debootstrap"
    exit 0
fi

base=target/container/debian
root=target/container/root
if [ ! -f $base/.ready ]; then
    rm -rf $base
    mkdir -p target/container
    debootstrap --variant=minbase --include=python3,python3-venv bookworm $base ${DEBIAN_MIRROR:-} >/dev/null
    touch $base/.ready
fi
umount $root/proc 2>/dev/null || true
rm -rf $root
cp -a $base $root
# Programs find their own folder there, as on any system that runs.
mount -t proc proc $root/proc
trap 'umount $root/proc' EXIT
trap 'exit 1' INT TERM
mkdir -p $root/packages
cp target/dist/renderflow-*.tar.gz target/wheels/renderflow-*.whl $root/packages/
python3 -m pip download -q --disable-pip-version-check --only-binary :all: --python-version 3.11 --platform manylinux_2_28_x86_64 \
    --platform manylinux2014_x86_64 -d $root/packages numpy "pyoidn==2.5.1.0"

within() {
    env -i PATH=/usr/local/bin:/usr/bin:/bin:/usr/sbin HOME=/root chroot $root sh -euc "$1"
}
seconds() {
    start=$(date +%s.%N)
    within "$2"
    echo "$1: $(echo "$(date +%s.%N) $start" | awk '{ printf "%.1f", $1 - $2 }') s"
}

within true
if within "command -v rustc || command -v cc" >/dev/null; then
    echo "the chroot has a compiler" >&2
    exit 1
fi

picture="render --seed 7 --resolution 256 --spp 16 --denoise oidn -q"
seconds "archive, unpacked, to the first picture" \
    "mkdir /archive && tar -C /archive --strip-components 1 -xzf /packages/renderflow-*.tar.gz && /archive/renderflow $picture -o /out-archive >/dev/null"
seconds "wheel, pip install to the first picture" \
    "python3 -m venv /venv && /venv/bin/pip install -q --no-index --find-links /packages renderflow pyoidn &&
     /venv/bin/renderflow $picture -o /out-wheel >/dev/null"

# What the second stage of Dockerfile copies, with its commands.
grep -q 'COPY --from=build /source/target/release/renderflow /opt/renderflow/renderflow' Dockerfile
grep -q 'COPY --from=build /source/.oidn/pyoidn/oidn/lib /opt/renderflow/lib' Dockerfile
grep -q 'RUN ln -s /opt/renderflow/renderflow /usr/local/bin/renderflow' Dockerfile
mkdir -p $root/opt/renderflow $root/work
cp target/release/renderflow $root/opt/renderflow/renderflow
cp -rL .oidn/pyoidn/oidn/lib $root/opt/renderflow/lib
within "ln -s /opt/renderflow/renderflow /usr/local/bin/renderflow"
seconds "container, to the first picture" "cd /work && renderflow $picture -o /out-container >/dev/null"

# One picture, whichever way the program came.
for out in wheel container; do
    cmp $root/out-archive/frame.0000.exr $root/out-$out/frame.0000.exr
done
within "/venv/bin/python -c 'import renderflow as rf; frame = rf.render(rf.compose(7, resolution=64), spp=2); print(sorted(frame))'"
within "renderflow doctor"
echo "one picture from the archive, the wheel and the container"
