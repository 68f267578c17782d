#!/bin/sh
# Trains with several processes on this machine's loopback, by Open MPI: the run of one process, killed and interrupted processes,
# what is refused.
#   sh tests/mpi/run.sh            everything; as root on Debian, where Open MPI's packages are installed if they are not there
#   SCALE=1 sh tests/mpi/run.sh    measures crops per second by the number of processes instead
# RENDERFLOW_MPI names a program that was built with --features mpi; without it, one is built. Skipped, with the reason, where
# Open MPI is not to be had.
set -eu
cd "$(dirname "$0")/../.."
CARGO=${CARGO:-cargo}

skip() {
    echo "skipped: tests/mpi: $*"
    exit 0
}
fail() {
    echo "FAILED: tests/mpi: $*" >&2
    exit 1
}

missing() {
    for tool in mpirun mpicc; do
        command -v $tool >/dev/null || echo $tool
    done
    # The bindings of the crate mpi are generated with libclang.
    [ -n "${LIBCLANG_PATH-}" ] || find /usr/lib /usr/local/lib -name 'libclang*.so*' 2>/dev/null | grep -q . || echo libclang
}
if [ -n "$(missing)" ]; then
    what=$(missing | tr '\n' ' ')
    command -v apt-get >/dev/null || skip "${what}not installed, and no apt-get"
    [ "$(id -u)" = 0 ] || skip "${what}not installed, and installing needs root"
    install() { DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends openmpi-bin libopenmpi-dev libclang-dev; }
    { install || { apt-get update -qq && install; }; } >/dev/null 2>&1 || true
    [ -z "$(missing)" ] || skip "Open MPI's packages cannot be installed"
fi

site=$(mktemp -d)
job=
cleanup() {
    status=$?
    trap - EXIT
    [ -z "$job" ] || kill -KILL "$job" 2>/dev/null || true
    [ $status = 0 ] || tail -n 20 "$site"/*.log 2>/dev/null || true
    rm -rf "$site"
    exit $status
}
trap cleanup EXIT
trap 'exit 1' INT TERM HUP

if [ -n "${RENDERFLOW_MPI-}" ]; then
    program=$(realpath "$RENDERFLOW_MPI")
else
    target=${CARGO_TARGET_DIR:-target}
    $CARGO build --release --features mpi
    # tests/slurm/run.sh uses it too.
    cp "$target/release/renderflow" "$target/renderflow-mpi"
    program=$(realpath "$target/renderflow-mpi")
    # The program without MPI takes its place again.
    $CARGO build --release
fi

# Root may start processes, more of them than cores, and they talk through the loopback interface.
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMPI_MCA_rmaps_base_oversubscribe=1
export OMPI_MCA_btl=self,tcp OMPI_MCA_btl_tcp_if_include=lo OMPI_MCA_oob_tcp_if_include=lo
# Seconds that mpirun waits before SIGTERM, and again before SIGKILL: a step and a checkpoint must fit.
export OMPI_MCA_odls_base_sigkill_timeout=5 PRTE_MCA_odls_base_sigkill_timeout=5

"$program" dataset plan --seed 5 --sequences 6 --frames 4 --resolution 64 --spp 4 --denoise none --out "$site/plan.json" >/dev/null
"$program" train --plan "$site/plan.json" -o "$site/none" --print-config >"$site/default.json"
# configure NAME EDIT: the default configuration, changed by a line of Python.
configure() {
    python3 - "$site/default.json" "$site/$1.json" "$2" <<'PYTHON'
import json, sys
run = json.load(open(sys.argv[1]))
training, recipe = run["training"], run["recipe"]
exec(sys.argv[3])
json.dump(run, open(sys.argv[2], "w"))
PYTHON
}
small='training["network"]["widths"] = [16, 16, 16, 16]; training["crops"] = [dict(size=32, batch=8, **{"from": 0.0})]
training.update(steps=120, first=2, rotate_steps=40, window=3, checkpoint_steps=20, log_steps=5, warmup_steps=10, products="f32")
recipe.update(truth_spp=4, key_spp=4, frames=1); run["validation"] = 1'
configure run "$small"
configure half "$small; training['gradients'] = 'f16'"

# alone NAME, and together PROCESSES NAME [CONFIGURATION]: a run in the folder NAME.
training() { echo "$program" train --config "$site/${2:-run}.json" --plan "$site/plan.json" --keep "$site/kept" -o "$site/$1" --threads 1 -q; }
alone() { $(training "$1") >"$site/$1.log" 2>&1; }
together() { mpirun -n "$1" --bind-to none $(training "$2" "${3-}") >>"$site/$2.log" 2>&1; }
# same A B TOLERANCE: losses and gradients of the first 40 steps of two logs. Later on roundings have grown: losses may be 1 %
# apart, and values of the checkpoints 5 %.
same() {
    python3 - "$site/$1" "$site/$2" "$3" <<'PYTHON'
import array, json, struct, sys
a, b, most = sys.argv[1], sys.argv[2], float(sys.argv[3])
def log(folder):
    return [json.loads(line) for line in open(folder + "/log.jsonl")]
def values(folder):
    bytes = open(folder + "/checkpoint.safetensors", "rb").read()
    size = struct.unpack("<Q", bytes[:8])[0]
    header = json.loads(bytes[8 : 8 + size])
    parts = {name: of["data_offsets"] for name, of in header.items() if name.startswith("value/")}
    return {name: array.array("f", bytes[8 + size + x : 8 + size + y]) for name, (x, y) in parts.items()}
one, other = log(a), log(b)
assert [line["step"] for line in one] == [line["step"] for line in other] and len(one) > 10, "other steps"
def apart(key, lines):
    return max(abs(x[key] - y[key]) / max(abs(x[key]), 1e-6) for x, y in lines)
lines = list(zip(one, other))
early = [pair for pair in lines if pair[0]["step"] <= 40]
first = max(apart("loss", early), apart("gradient_norm", early))
later = apart("loss", lines)
one, other = values(a), values(b)
assert one.keys() == other.keys() and one
scale = max(abs(v) for of in one.values() for v in of)
weights = max(abs(x - y) for name in one for x, y in zip(one[name], other[name])) / scale
print(f"{a.split('/')[-1]} and {b.split('/')[-1]}: losses and gradients of 40 steps {first:.2g} apart, losses of {lines[-1][0]['step']}"
    f" steps {later:.2g}, weights {weights:.2g}")
assert first <= most and later <= 0.01 and weights <= 0.05, "too far apart"
PYTHON
}
. tests/common/wait.sh

if [ -n "${SCALE-}" ]; then
    unset OMPI_MCA_btl OMPI_MCA_btl_tcp_if_include
    cores=$(nproc)
    large='training["crops"] = [dict(size=96, batch=8, **{"from": 0.0})]; recipe.update(truth_spp=4, key_spp=4, frames=1); run["validation"] = 0
training.update(steps=40, first=2, rotate_steps=1000, window=2, checkpoint_steps=1000, log_steps=20)'
    large_plan() { "$program" dataset plan --seed 5 --sequences 2 --frames 4 --resolution 128 --spp 4 --denoise none --out "$site/plan.json" --overwrite; }
    large_plan >/dev/null 2>&1 || { rm "$site/plan.json" && large_plan >/dev/null; }
    echo "| processes x threads | gradients | crops/s |"
    echo "|---|---|---|"
    processes=1
    while [ "$processes" -le "$cores" ] && [ "$processes" -le 8 ]; do
        for format in f32 f16; do
            [ "$processes$format" != 1f16 ] || continue
            configure run "$large; training['gradients'] = '$format'"
            out=scale-$processes-$format
            mpirun -n $processes --bind-to none "$program" train --config "$site/run.json" --plan "$site/plan.json" --keep "$site/kept" \
                -o "$site/$out" --threads $((cores / processes)) -q >"$site/$out.log" 2>&1
            rate=$(tail -n 1 "$site/$out/log.jsonl" | python3 -c 'import json, sys; print("%.2f" % json.load(sys.stdin)["items_per_second"])')
            echo "| $processes x $((cores / processes)) | $format | $rate |"
        done
        processes=$((2 * processes))
    done
    exit 0
fi

# 1. One process and two make the same run, and two make the same bytes again.
begun=$(now)
alone one || fail "one process"
echo "one process: $(since "$begun") s"
begun=$(now)
together 2 two || fail "two processes"
echo "two processes: $(since "$begun") s"
same one two 0.002
[ "$(grep -c '120 steps in' "$site/two.log")" = 1 ] || fail "one process should report"
together 2 again || fail "two processes, again"
cmp "$site/two/weights.safetensors" "$site/again/weights.safetensors" || fail "two runs of two processes differ"
together 2 half half || fail "half precision"
same one half 0.05

# 2. A process is killed: the others end, and the run goes on from its checkpoint.
past() { [ "$(tail -n 1 "$site/$1/log.jsonl" 2>/dev/null | sed 's/.*"step":\([0-9]*\).*/\1/')" -ge "$2" ] 2>/dev/null; }
start() {
    together 2 "$1" &
    waiting=$!
    within 120 past "$1" 45 || fail "$1: no steps"
    # The shell of `together`, then mpirun.
    job=$(pgrep -P $waiting -x mpirun || echo $waiting)
}
# The processes of the job.
processes() { pgrep -P "$job" -x "$(basename "$program" | cut -c 1-15)"; }
start killed
victim=$(processes | tail -n 1)
[ -n "$victim" ] || fail "killed: there is no process to kill"
begun=$(now)
kill -KILL "$victim"
status=0
wait $waiting || status=$?
job=
[ $status != 0 ] || fail "killed: the run ended well"
echo "killed: status $status after $(since "$begun") s, at step $(tail -n 1 "$site/killed/log.jsonl" | sed 's/.*"step":\([0-9]*\).*/\1/')"
together 2 killed || fail "killed: does not go on"
cmp "$site/two/weights.safetensors" "$site/killed/weights.safetensors" || fail "killed: differs from the run that was not"

# 3. One process is told to stop: all do. (With Ctrl-C, mpirun tells all of them, after the seconds above.)
start interrupted
begun=$(now)
kill -TERM "$(processes | head -n 1)"
status=0
wait $waiting || status=$?
job=
stopped=$(tail -n 1 "$site/interrupted/log.jsonl" | sed 's/.*"step":\([0-9]*\).*/\1/')
echo "interrupted: status $status after $(since "$begun") s, at step $stopped"
grep -q 'run the same command again to go on' "$site/interrupted.log" || fail "interrupted: does not say so"
together 2 interrupted || fail "interrupted: does not go on"
cmp "$site/two/weights.safetensors" "$site/interrupted/weights.safetensors" || fail "interrupted: differs from the run that was not"

# 4. What cannot work is refused at once.
refused() {
    name=$1 said=$2
    shift 2
    status=0
    timeout 60 "$@" >"$site/$name.log" 2>&1 || status=$?
    [ $status != 0 ] && [ $status != 124 ] || fail "$name: status $status"
    grep -q "$said" "$site/$name.log" || fail "$name: does not say \"$said\""
    [ ! -e "$site/$name/checkpoint.safetensors" ] || fail "$name: has trained"
}
refused rest 'crops.batch: 8 cannot be shared equally by 3 processes' mpirun -n 3 --bind-to none $(training rest)
refused strangers 'says that 2 processes were started to train together, but MPI finds 1' \
    env SLURM_STEP_NUM_TASKS=2 SLURM_PROCID=0 $(training strangers)
plain=${RENDERFLOW:-target/release/renderflow}
if [ -x "$plain" ]; then
    refused plain 'was built without MPI' mpirun -n 2 --bind-to none "$plain" train --plan "$site/plan.json" -o "$site/plain"
fi
mkdir -p "$site/differs"
refused differs 'begins with other options or data than process 0' \
    mpirun --bind-to none -n 1 $(training differs) : -n 1 $(training differs) --steps 99
echo "refusals: as they should be"
