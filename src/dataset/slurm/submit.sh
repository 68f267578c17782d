#!/bin/sh
# Submits array.sh for every shard and merge.sh behind it. `submit.sh --dry-run` prints the commands instead.
set -eu
folder=@FOLDER@
# As Slurm wants it: %% is a percent sign.
logs=@LOGS@
shards=@SHARDS@
# What Slurm takes unless told otherwise: MaxArraySize is 1001, and task numbers are below it.
array_limit=1000
# Tasks that may run at a time, 0 = any number; split over the arrays by their lengths.
at_once=@AT_ONCE@

dry_run=
case "${1-}" in
'') ;;
--dry-run) dry_run=1 ;;
*)
    echo "usage: submit.sh [--dry-run]" >&2
    exit 2
    ;;
esac

cd "$folder"
[ -n "$dry_run" ] || mkdir -p logs
jobs=
trap '[ -z "$jobs" ] || echo "submitted before the failure: $(echo "$jobs" | tr : " ")" >&2' EXIT

# Submits, or prints the command; the job's number is in `job`.
submit() {
    if [ -n "$dry_run" ]; then
        job="<$1>"
        shift
        echo "sbatch $*"
    else
        shift
        job=$(sbatch --parsable "$@")
        job=${job%%;*}
        echo "$job: sbatch $*"
    fi
}

offset=0
while [ "$offset" -lt "$shards" ]; do
    length=$((shards - offset))
    [ "$length" -le "$array_limit" ] || length=$array_limit
    end=$((offset + length))
    tasks=1-$length
    if [ "$at_once" -gt 0 ]; then
        share=$((at_once * end / shards - at_once * offset / shards))
        [ "$share" -gt 0 ] || share=1
        tasks=$tasks%$share
    fi
    # Where fewer tasks may run than there are arrays, each array waits for the one that comes so many places before it.
    after=
    if [ "$at_once" -gt 0 ] && [ $((offset / array_limit)) -ge "$at_once" ]; then
        after=--dependency=afterany:$(echo "$jobs" | tr : '\n' | tail -n "$at_once" | head -n 1)
    fi
    submit "job $((offset / array_limit + 1))" "--array=$tasks" ${after:+"$after"} "--output=$logs/%A_%a.out" array.sh "$offset"
    jobs=$jobs${jobs:+:}$job
    offset=$end
done
submit merge "--dependency=afterok:$jobs" --kill-on-invalid-dep=yes "--output=$logs/merge_%j.out" merge.sh
jobs=
