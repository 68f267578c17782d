# For scripts that watch other programs.
now() { date +%s.%N; }
# since BEGUN: seconds since `now` said BEGUN.
since() { awk "BEGIN { printf \"%.1f\", $(now) - $1 }"; }
# within SECONDS COMMAND..: waits until the command succeeds.
within() {
    limit=$(($(date +%s) + $1))
    shift
    until "$@"; do
        [ "$(date +%s)" -lt $limit ] || return 1
        sleep 0.05
    done
}
