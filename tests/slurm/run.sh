#!/bin/sh
# Renders datasets and trains on a real Slurm: controller and node daemon on this machine's loopback, in a temporary folder, gone at
# the end.
#   sh tests/slurm/run.sh              everything; as root on Debian, where Slurm's packages are installed if they are not there
#   TASKS=200 sh tests/slurm/run.sh    measures the overhead with so many tasks (60)
# RENDERFLOW names the program (target/release/renderflow), RENDERFLOW_MPI one that was built with --features mpi
# (target/renderflow-mpi, which tests/mpi/run.sh makes). Without the latter, jobs of several processes are skipped. So is everything,
# with the reason, where Slurm cannot be run.
set -eu
cd "$(dirname "$0")/../.."
program=$(realpath "${RENDERFLOW:-target/release/renderflow}")
with_mpi=${RENDERFLOW_MPI:-target/renderflow-mpi}
tasks=${TASKS:-60}

skip() {
    echo "skipped: tests/slurm: $*"
    exit 0
}
fail() {
    echo "FAILED: tests/slurm: $*" >&2
    exit 1
}
[ "$(id -u)" = 0 ] || skip "Slurm's daemons need root"
[ -x "$program" ] || fail "$program: build it first"

missing() {
    for tool in slurmctld slurmd sbatch scontrol munged; do
        command -v $tool >/dev/null || echo $tool
    done
}
if [ -n "$(missing)" ]; then
    command -v apt-get >/dev/null || skip "$(missing | tr '\n' ' ')not installed, and no apt-get"
    # The packages would start their services, or fail to.
    policy=/usr/sbin/policy-rc.d
    [ -e $policy ] || { printf '#!/bin/sh\nexit 101\n' >$policy && chmod +x $policy && trap 'rm -f $policy' EXIT; }
    install() { DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends slurmctld slurmd slurm-client munge; }
    { install || { apt-get update -qq && install; }; } >/dev/null 2>&1 || true
    trap - EXIT
    grep -qx 'exit 101' $policy && [ "$(wc -l <$policy)" = 2 ] && rm -f $policy
    [ -z "$(missing)" ] || skip "Slurm's packages cannot be installed"
fi

# Processes of their own: whatever is started here ends with this script, even where it is killed.
if [ -z "${INSIDE-}" ] && unshare --pid --fork --kill-child --mount-proc true 2>/dev/null; then
    INSIDE=1 exec unshare --pid --fork --kill-child --mount-proc sh "$0"
fi

site=$(mktemp -d)
chmod 755 "$site"
daemons="slurmd slurmctld munged"
cleanup() {
    status=$?
    trap - EXIT
    if [ $status != 0 ]; then
        tail -n 20 "$site"/log/*.log "$site"/*/jobs/logs/* 2>/dev/null || true
    fi
    scancel --quiet --user=root 2>/dev/null || true
    scancel --quiet --user=nobody 2>/dev/null || true
    for daemon in $daemons; do
        [ ! -s "$site/run/$daemon.pid" ] || kill "$(cat "$site/run/$daemon.pid")" 2>/dev/null || true
    done
    within 20 stopped || echo "warning: a daemon did not stop" >&2
    rm -rf "$site"
    exit $status
}
running() { [ -s "$site/run/$1.pid" ] && kill -0 "$(cat "$site/run/$1.pid")" 2>/dev/null; }
stopped() {
    for daemon in $daemons; do
        ! running "$daemon" || return 1
    done
}
. tests/common/wait.sh
trap cleanup EXIT
trap 'exit 1' INT TERM HUP

# A controller and a node. Of the defaults, these are changed so that the test takes minutes:
#   cred_expire 5 (120 s)    a requeued task waits so long and a second more before it starts again;
#   SlurmdTimeout 15 (300)   a node that says nothing is down after that;
#   BatchStartTimeout 1 (10) when a node comes back, tasks it does not know are lost if older than this and MessageTimeout (10); the
#                            younger wait for the node's next report, minutes later;
#   KillWait 5 (30)          seconds from SIGTERM to SIGKILL.
mkdir -p "$site/state" "$site/spool" "$site/log" "$site/run"
free_port() {
    while :; do
        port=$((20000 + $(od -An -N2 -tu2 /dev/urandom) % 40000))
        grep -qi ":$(printf '%04X' $port) " /proc/net/tcp || break
    done
    echo $port
}
head -c 128 /dev/urandom >"$site/munge.key"
chmod 400 "$site/munge.key"
host=$(hostname -s)
cores=$(nproc)
cat >"$site/slurm.conf" <<CONF
ClusterName=loop
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
AuthType=auth/munge
CryptoType=crypto/munge
AuthInfo=socket=$site/run/munged.socket,cred_expire=5
SlurmctldPort=$(free_port)
SlurmdPort=$(free_port)
StateSaveLocation=$site/state
SlurmdSpoolDir=$site/spool
SlurmctldPidFile=$site/run/slurmctld.pid
SlurmdPidFile=$site/run/slurmd.pid
SlurmctldLogFile=$site/log/slurmctld.log
SlurmdLogFile=$site/log/slurmd.log
ProctrackType=proctrack/pgid
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
ReturnToService=2
SlurmdTimeout=15
BatchStartTimeout=1
KillWait=5
MpiDefault=none
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
NodeName=$host NodeAddr=127.0.0.1 CPUs=$cores RealMemory=8000 State=UNKNOWN
PartitionName=render Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF
export SLURM_CONF="$site/slurm.conf"
munged --force --num-threads=2 --socket="$site/run/munged.socket" --key-file="$site/munge.key" --seed-file="$site/run/munged.seed" \
    --pid-file="$site/run/munged.pid" --log-file="$site/log/munged.log" 2>/dev/null || fail "munged does not start"
slurmctld -f "$SLURM_CONF" || fail "slurmctld does not start"
start_node() { slurmd -f "$SLURM_CONF" -N "$host" || fail "slurmd does not start"; }
start_node
idle() { [ "$(sinfo -h -o %t 2>/dev/null)" = idle ]; }
within 60 idle || fail "the node does not come up: $(sinfo 2>&1)"
echo "slurm $(slurmctld -V | cut -d' ' -f2), $cores cores"

# plan NAME SEQUENCES FRAMES PIXELS SPP, then what one process makes of it, undisturbed.
plan() {
    mkdir -p "$site/$1"
    "$program" dataset plan --seed 5 --sequences "$2" --frames "$3" --resolution "$4" --spp "$5" --keyframe-gap 2 --denoise none \
        --out "$site/$1/plan.json"
    begun=$(now)
    "$program" dataset render --plan "$site/$1/plan.json" --out "$site/$1/alone" --shard 1/1 2>"$site/log/alone.log" ||
        fail "alone: $(cat "$site/log/alone.log")"
    echo "$1: $2 sequences of $3 frames, $(since "$begun") s in one process"
}
# submit NAME OUT [options of dataset slurm]: numbers of the array and of the merge in `array` and `merge`.
submit() {
    name=$1 out=$2
    shift 2
    "$program" dataset slurm --plan "$site/$name/plan.json" --out "$site/$name/$out" --script-dir "$site/$out/jobs" --cpus 1 \
        --memory 500M --program "$program" "$@" >/dev/null
    jobs=$(sh "$site/$out/jobs/submit.sh" | cut -d: -f1)
    array=$(echo "$jobs" | head -n 1)
    merge=$(echo "$jobs" | tail -n 1)
}
state() { squeue -h -t all -j "$1" -o %T 2>/dev/null; }
ended() { case $(state "$1") in PENDING | RUNNING | COMPLETING | CONFIGURING) return 1 ;; esac; }
# finish NAME OUT SECONDS: waits for the merge; all files but clocks and logs must be those of one process.
finish() {
    within "$3" ended "$merge" || fail "$2: the merge has not ended after $3 s: $(squeue)"
    [ "$(state "$merge")" = COMPLETED ] || fail "$2: the merge is $(state "$merge")"
    [ -f "$site/$1/$2/manifest.json" ] || fail "$2: no manifest"
    diff -r --exclude=timing.json --exclude=logs "$site/$1/alone" "$site/$1/$2" || fail "$2: differs from one process"
    echo "$2: $(find "$site/$1/$2" -type f | wc -l) files, the same bytes as one process"
}
frames() { find "$site/$1" -name 'frame.*' 2>/dev/null | wc -l; }
some_frames() { [ "$(frames "$1")" -ge "$2" ]; }
said() { grep -qs "$2" "$site/$1"/jobs/logs/*; }

# 1. Undisturbed.
plan small 6 3 48 4
begun=$(now)
submit small undisturbed --tasks-at-once 3
finish small undisturbed 120
echo "undisturbed: $(since "$begun") s from submission to the end of the merge"

# 2. The node's daemon, its step daemons and all their tasks are killed at once; the node comes back.
# Frames of 2.5 s or so, whatever the machine: tasks must still be at work when old enough to be missed.
mkdir -p "$site/pace"
"$program" dataset plan --seed 5 --sequences 1 --frames 4 --resolution 64 --spp 256 --denoise none --out "$site/pace/plan.json"
begun=$(now)
"$program" dataset render --plan "$site/pace/plan.json" --out "$site/pace/alone" --shard 1/1 --threads 1 2>/dev/null || fail "pace"
plan long 6 8 64 "$(awk "BEGIN { print int(256 * 2.5 * 4 / ($(since "$begun") + 0.1)) }")"
submit long killed
within 60 some_frames long/killed 1 || fail "killed: no frames"
sleep 12
victims=$(scontrol listpids | awk 'NR > 1 && $1 > 1 { print $1 }')
for pid in $victims; do
    parent=$(ps -o ppid= -p "$pid" 2>/dev/null | tr -d ' ') || continue
    case $(ps -o comm= -p "${parent:-0}" 2>/dev/null) in slurmstepd*) victims="$parent $victims" ;; esac
done
[ "$(echo "$victims" | wc -w)" -ge 3 ] || fail "killed: nothing to kill: $victims"
kill -9 "$(cat "$site/run/slurmd.pid")"
# shellcheck disable=SC2086
kill -9 $victims 2>/dev/null || true
begun=$(now)
echo "killed: slurmd and $(echo "$victims" | tr ' ' '\n' | sort -u | wc -l) processes, at $(frames long/killed) of 48 frames"
start_node
noticed() { grep -qE 'Killing|requeue|Requeu|missing|not found on node|NODE_FAIL' "$site/log/slurmctld.log"; }
within 400 noticed && echo "killed: the controller noticed after $(since "$begun") s"
within 400 said killed 'restart 1: starts' || fail "killed: no task was restarted: $(squeue)"
echo "killed: the first task ran again after $(since "$begun") s"
finish long killed 400
echo "killed: everything was there after $(since "$begun") s"

# 3. One task is told to stop: it finishes its frame, says so, and goes on later.
submit long told
within 60 some_frames long/told/train/seq-000001 1 || fail "told: no frames"
before=$(find "$site/long/told/train/seq-000001" -name 'frame.*' | wc -l)
begun=$(now)
# Slurm 22.05 signals twice; where it refuses the second, it goes on trying for 18 seconds, into the next run of the task.
timeout 2 scancel --signal=TERM --batch "${array}_2" || true
within 60 said told "task ${array}_2, restart 0: interrupted" || fail "told: the task did not stop: $(squeue)"
after=$(find "$site/long/told/train/seq-000001" -name 'frame.*' | wc -l)
[ "$after" = $((before + 1)) ] || fail "told: $before frames when told to stop, $after when it had"
echo "told: stopped after $(since "$begun") s with $after frames, one more than when told"
# The tasks that took its place end first.
within 400 said told "task ${array}_2, restart 1: starts" || fail "told: the task did not start again: $(squeue)"
echo "told: ran again after $(since "$begun") s"
finish long told 400

# 4. Too little memory, as a user without rights of an operator: twice as much the next time.
mkdir -p "$site/starved/jobs"
cat >"$site/starved/program" <<STARVED
#!/bin/sh
[ "\$2" = merge ] || [ "\$SLURM_MEM_PER_NODE" -ge 1000 ] || kill -9 \$\$
exec "$program" "\$@"
STARVED
chmod 755 "$site/starved/program"
if install -d -o nobody "$site/small/starved" 2>/dev/null && chown -R nobody "$site/starved" && runuser -u nobody -- test -x "$program"; then
    real=$program program="$site/starved/program"
    submit_as() { runuser -u nobody -- "$@"; }
    "$real" dataset slurm --plan "$site/small/plan.json" --out "$site/small/starved" --script-dir "$site/starved/jobs" --cpus 1 \
        --memory 500M --program "$program" >/dev/null
    begun=$(now)
    jobs=$(submit_as sh "$site/starved/jobs/submit.sh" | cut -d: -f1)
    merge=$(echo "$jobs" | tail -n 1)
    program=$real
    finish small starved 120
    said starved 'killed with 500 MB (status 137); tried again with 1000 MB' || fail "starved: no task had its memory doubled"
    echo "starved: $(since "$begun") s, every task killed once and given twice the memory"
else
    echo "skipped: starved: user nobody cannot run $program"
fi

# 5. A training: undisturbed, with a process killed, and told to stop. Each ends with the weights of a run without Slurm.
# Root may start processes with Open MPI, more of them than cores; they talk through the loopback interface.
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMPI_MCA_rmaps_base_oversubscribe=1
export OMPI_MCA_btl=self,tcp OMPI_MCA_btl_tcp_if_include=lo OMPI_MCA_oob_tcp_if_include=lo
mkdir -p "$site/training"
"$program" dataset plan --seed 5 --sequences 3 --frames 4 --resolution 64 --spp 4 --denoise none --out "$site/training/plan.json" >/dev/null
cat >"$site/training/run.json" <<CONFIG
{"network": "fusion", "training": {"network": {"widths": [16, 16, 16, 16]}, "crops": [{"size": 32, "batch": 8, "from": 0.0}],
"steps": 800, "first": 2, "rotate_steps": 100, "window": 3, "checkpoint_steps": 1000, "log_steps": 5, "products": "f32"},
"recipe": {"truth_spp": 4, "key_spp": 4, "frames": 1}, "validation": 1}
CONFIG
# train NAME: what follows `train` on the command line.
train() { echo --config "$site/training/run.json" --plan "$site/training/plan.json" --keep "$site/training/kept" -o "$site/training/$1"; }
# submit_training NAME PROCESSES [options of train slurm]: number of the job in `job`.
submit_training() {
    run=$1 tasks_of_run=$2
    shift 2
    # shellcheck disable=SC2046
    "$program" train slurm --processes "$tasks_of_run" --cpus 1 --memory 2G --time 00:20:00 --grace 9 \
        --script-dir "$site/training/$run-job" \
        --extra "--output=$site/training/$run.log" "$@" -- $(train "$run") >/dev/null || fail "$run: train slurm"
    job=$(sbatch --parsable "$site/training/$run-job/job.sh") || fail "$run: sbatch"
}
stepped() { [ "$(tail -n 1 "$site/training/$1/log.jsonl" 2>/dev/null | sed 's/.*"step":\([0-9]*\).*/\1/')" -ge "$2" ] 2>/dev/null; }
reported() { grep -qs "$2" "$site/training/$1.log"; }
trained() { # NAME LIKE
    within 400 ended "$job" || fail "$1: the job has not ended: $(squeue)"
    [ "$(state "$job")" = COMPLETED ] || fail "$1: the job is $(state "$job"): $(tail -n 5 "$site/training/$1.log")"
    cmp "$site/training/$2/weights.safetensors" "$site/training/$1/weights.safetensors" || fail "$1: other weights than $2"
    echo "$1: the same weights as $2"
}
# shellcheck disable=SC2046
"$program" train $(train alone) --threads 1 -q >"$site/log/alone.log" 2>&1 || fail "training: $(tail -n 5 "$site/log/alone.log")"
# disturb NAME PROCESSES VICTIM LIKE [options of train slurm]: three runs that must have the weights of the run LIKE. The first is left
# alone, in the second a process called VICTIM is killed, and the third is told to stop.
disturb() {
    name=$1 processes=$2 victim=$3 like=$4
    shift 4
    submit_training "$name" "$processes" "$@"
    trained "$name" "$like"

    submit_training "$name-killed" "$processes" "$@"
    within 120 stepped "$name-killed" 45 || fail "$name-killed: no steps: $(squeue; tail -n 5 "$site/training/$name-killed.log")"
    pkill -KILL -n -x "$victim" || fail "$name-killed: there is no $victim"
    begun=$(now)
    within 120 reported "$name-killed" 'restart 0: ended with status' || fail "$name-killed: the job did not notice: $(tail -n 5 "$site/training/$name-killed.log")"
    within 120 reported "$name-killed" 'restart 1: starts' || fail "$name-killed: the job did not start again"
    echo "$name-killed: started again after $(since "$begun") s"
    trained "$name-killed" "$like"

    submit_training "$name-told" "$processes" "$@"
    within 120 stepped "$name-told" 45 || fail "$name-told: no steps"
    begun=$(now)
    # Without --batch, the processes that srun started are told, as at the end of the time.
    case $* in *mpirun*) to=--batch ;; *) to= ;; esac
    # shellcheck disable=SC2086
    timeout 2 scancel --signal=TERM $to "$job" || true
    within 60 reported "$name-told" 'restart 0: interrupted' || fail "$name-told: did not stop: $(tail -n 5 "$site/training/$name-told.log")"
    # There is no other checkpoint than the one of the stop.
    [ -s "$site/training/$name-told/checkpoint.safetensors" ] || fail "$name-told: stopped without a checkpoint"
    echo "$name-told: stopped after $(since "$begun") s, at step $(tail -n 1 "$site/training/$name-told/log.jsonl" | sed 's/.*"step":\([0-9]*\).*/\1/')"
    within 120 reported "$name-told" 'restart 1: starts' || fail "$name-told: the job did not start again"
    trained "$name-told" "$like"
}
running_as() { basename "$1" | cut -c 1-15; }
pmix() { srun --mpi=list 2>&1 | grep -q pmix; }
if command -v mpirun >/dev/null; then
    disturb training 1 "$(running_as "$program")" alone --launcher mpirun
else
    echo "skipped: training: there is no mpirun"
fi
if [ -x "$with_mpi" ] && [ "$cores" -ge 2 ]; then
    both=$(realpath "$with_mpi")
    # shellcheck disable=SC2046
    mpirun -n 2 --bind-to none "$both" train $(train together) --threads 1 -q >"$site/log/together.log" 2>&1 ||
        fail "training by two: $(tail -n 5 "$site/log/together.log")"
    disturb two 2 "$(running_as "$both")" together --launcher mpirun --program "$both"
    if pmix; then
        disturb srun 2 "$(running_as "$both")" together --launcher srun --program "$both"
    else
        echo "skipped: two processes by srun: this Slurm has no plugin for PMIx"
    fi
else
    echo "skipped: two processes: $with_mpi is not there, or there is one core only"
fi

# 6. What Slurm costs a task: tasks that do nothing, and tasks of one small frame against the same work without Slurm.
measure() { awk "BEGIN { printf \"%.3f\", ($1) }"; }
array_done() { ! state "$1" | grep -qvx COMPLETED; }
empty_tasks() {
    begun=$(now)
    array=$(sbatch --parsable --array="1-$tasks" --cpus-per-task=1 --mem=100M --output=/dev/null --wrap true)
    within 600 array_done "$array" || fail "empty tasks: $(squeue | head)"
    empty=$(since "$begun")
    echo "overhead: $tasks empty tasks, $cores at a time, $1: $empty s, $(measure "$empty / $tasks") s a task, $(measure "$empty * $cores / $tasks") s of a core a task"
}
empty_tasks "batch_sched_delay 3 (the default)"

mkdir -p "$site/tiny"
"$program" dataset plan --seed 6 --sequences "$tasks" --frames 1 --resolution 48 --spp 4 --denoise none --out "$site/tiny/plan.json"
begun=$(now)
seq "$tasks" | xargs -P "$cores" -I{} "$program" dataset render --plan "$site/tiny/plan.json" --out "$site/tiny/alone" --threads 1 \
    --shard "{}/$tasks" 2>"$site/log/alone.log" || fail "xargs: $(cat "$site/log/alone.log")"
direct=$(since "$begun")
begun=$(now)
submit tiny tasks
within 600 array_done "$array" || fail "tasks: $(squeue | head)"
slurm=$(since "$begun")
echo "overhead: $tasks tasks of one frame: $slurm s with Slurm, $direct s with xargs: $(measure "($slurm - $direct) / $tasks") s a task, $(measure "($slurm - $direct) * $cores / $tasks") s of a core a task"
finish tiny tasks 120

# Slurm starts what waits so long after something ended.
echo "SchedulerParameters=batch_sched_delay=0" >>"$site/slurm.conf"
scontrol reconfigure
empty_tasks "batch_sched_delay 0"
