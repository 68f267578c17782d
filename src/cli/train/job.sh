#!/bin/sh
# Trains a network with several processes. Submit it with `sbatch`; submitting it again continues the run.
#SBATCH --nodes=@NODES@
#SBATCH --ntasks=@PROCESSES@
#SBATCH --cpus-per-task=@CPUS@
#SBATCH --mem=@MEGABYTES@
#SBATCH --time=@TIME@
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=@SIGNAL@@@GRACE@
@DIRECTIVES@
set -u
program=@PROGRAM@
retries=@RETRIES@
job=${SLURM_JOB_ID:-0}
restarts=${SLURM_RESTART_COUNT:-0}
say() { echo "$(date '+%Y-%m-%dT%H:%M:%S') job $job, restart $restarts: $*"; }

# Where `train slurm` was called: paths are as they were there.
cd @FOLDER@ || exit 2

# With srun, Slurm tells all processes; with mpirun, it tells this shell. They finish the step and write a checkpoint.
@WAIT@

# When mpirun is told to stop, it waits so many seconds, tells the processes, waits again and kills them; by default 1. A third of the
# grace is left for what follows. Open MPI 4 and 5.
export OMPI_MCA_odls_base_sigkill_timeout=@PATIENCE@ PRTE_MCA_odls_base_sigkill_timeout=@PATIENCE@

say "starts on ${SLURM_JOB_NODELIST:-$(hostname)}"
run @LAUNCH@ "$program" train@ARGUMENTS@ --threads @CPUS@@ALLOWED@

case $status in
0)
    say "done"
    exit 0
    ;;
2) give_up "failed with status 2: the command cannot work" ;;
75 | 143) say "interrupted; goes on from its checkpoint" ;;
*)
    # An mpirun that was told to stop ends with 1.
    if [ "$signals" -gt 0 ]; then
        say "interrupted; goes on from its checkpoint"
    else
        say "ended with status $status; goes on from its last checkpoint"
    fi
    ;;
esac
[ "$restarts" -lt "$retries" ] || give_up "ended after $retries retries"
scontrol requeue "$job" || give_up "cannot be requeued"
exit "$status"
