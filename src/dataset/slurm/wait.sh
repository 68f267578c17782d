# Slurm tells the shell before the time is up or the node is taken away; the program can still finish what it has begun. Slurm may say
# so twice, and a second signal would make the program stop at once.
signals=0
child=
forward() {
    signals=$((signals + 1))
    [ "$signals" -gt 1 ] || [ -z "$child" ] || kill -TERM "$child" 2>/dev/null
}
trap forward TERM

# Runs a program and passes the first signal on to it. Its exit code is in `status`.
run() {
    "$@" &
    child=$!
    [ "$signals" -eq 0 ] || kill -TERM "$child" 2>/dev/null
    status=127
    seen=-1
    # A signal ends `wait` early: wait again for the program itself. Of a child that is gone by then, some shells know nothing (127).
    while [ "$seen" -ne "$signals" ]; do
        seen=$signals
        code=0
        wait "$child" || code=$?
        if [ "$code" -ne 127 ] || [ "$seen" -eq 0 ]; then status=$code; fi
    done
    # What is left to do is short, and a requeued task is sent the signal as well.
    trap '' TERM
}

give_up() {
    say "$1; not tried again"
    exit "$status"
}
