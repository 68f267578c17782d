#!/bin/sh
# One task of a Slurm array: one shard of a plan. Submitted by submit.sh with the number of shards before this array.
#SBATCH --nodes=1
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=@CPUS@
#SBATCH --mem=@MEGABYTES@
#SBATCH --time=@TIME@
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=B:TERM@@GRACE@
@DIRECTIVES@
set -u
program=@PROGRAM@
plan=@PLAN@
out=@OUT@
retries=@RETRIES@
export RENDERFLOW_SHARDS=@SHARDS@
export RENDERFLOW_SHARD_OFFSET="${1:-0}"

# Never SLURM_JOB_ID alone: that of one of the tasks is the number of the array, and then all of it is meant.
task=${SLURM_ARRAY_JOB_ID}_${SLURM_ARRAY_TASK_ID}
restarts=${SLURM_RESTART_COUNT:-0}
memory=${SLURM_MEM_PER_NODE:-@MEGABYTES@}
say() { echo "$(date '+%Y-%m-%dT%H:%M:%S') task $task, restart $restarts: $*"; }

@WAIT@

say "starts on $(hostname)"
run "$program" dataset render --plan "$plan" --out "$out" --threads "${SLURM_CPUS_PER_TASK:-@CPUS@}"@ALLOWED@

case $status in
0)
    say "done"
    exit 0
    ;;
2) give_up "failed with status 2: the command cannot work" ;;
esac
[ "$restarts" -lt "$retries" ] || give_up "ended with status $status after $retries retries"

case $status in
137 | 134)
    # Killed, or no memory to be had: where memory ran out, the same again would meet the same end. Only a waiting task's memory
    # can be changed, so it is held first.
    scontrol requeuehold "$task" || give_up "ended with status $status and cannot be requeued"
    if scontrol update JobId="$task" MinMemoryNode=$((2 * memory)); then
        say "killed with $memory MB (status $status); tried again with $((2 * memory)) MB"
        scontrol release "$task"
    else
        say "killed with $memory MB (status $status) and may not have more; not tried again"
        scancel "$task"
    fi
    ;;
75 | 143)
    # 143: told before it could listen.
    say "interrupted; goes on later"
    scontrol requeue "$task" || give_up "cannot be requeued"
    ;;
*)
    say "failed with status $status; tried again"
    scontrol requeue "$task" || give_up "cannot be requeued"
    ;;
esac
exit "$status"
