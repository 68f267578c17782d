#!/bin/sh
# Collects what the tasks of array.sh wrote into one dataset. Submitted by submit.sh, starts when all of them succeeded.
#SBATCH --nodes=1
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=1
#SBATCH --mem=@MEGABYTES@
#SBATCH --time=@TIME@
#SBATCH --requeue
#SBATCH --open-mode=append
@DIRECTIVES@
exec @PROGRAM@ dataset merge --plan @PLAN@ --out @OUT@
