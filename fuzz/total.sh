#!/bin/sh
# The executions so far, those of a run that still goes on too: fuzz/total.sh [TARGET ...]
set -eu
cd "$(dirname "$0")"
[ $# -gt 0 ] || set -- $(cd corpus && ls ./*.log | sed 's|^\./||; s|\.log$||')
printf '%-12s %14s %10s %8s %8s\n' target executions "per second" kept findings
for target in "$@"; do
    # A process says what it has done at its end; of one that has not ended, the last status line counts.
    # shellcheck disable=SC2012
    awk -v target="$target" -v kept="$(ls -U "corpus/$target" | wc -l)" -v found="$(ls -U "artifacts/$target" | wc -l)" '
        /^INFO: Seed:/ { sum += running; running = 0 }
        /^#[0-9]+/ { running = substr($1, 2) + 0 }
        /^stat::number_of_executed_units/ { sum += $2; running = 0 }
        /^stat::average_exec_per_sec/ { rate = $2 }
        /exec\/s: / { for (i = 1; i < NF; i++) if ($i == "exec/s:") rate = $(i + 1) }
        END { printf "%-12s %14d %10d %8d %8d\n", target, sum + running, rate, kept, found }' "corpus/$target.log"
done | awk '{ print; sum += $2 } END { if (NR > 1) printf "%-12s %14d\n", "all", sum }'
