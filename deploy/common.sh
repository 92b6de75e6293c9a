# Shell functions that the scripts of deploy share. Sourced, never run.
# shellcheck shell=bash

# The top of the checkout.
ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)

say() { printf '%s\n' "== $*" >&2; }

fail() {
  printf '%s\n' "$0: $*" >&2
  exit 1
}

# Every job at once needs about 1 GB of memory for its compiler; the cores may be more than that allows.
build_jobs() {
  local cores memory_gb
  cores=$(nproc)
  memory_gb=$(awk '/^MemAvailable:/ { print int($2 / 1048576) }' /proc/meminfo)
  if ((memory_gb < 1)); then memory_gb=1; fi
  echo $((cores < memory_gb ? cores : memory_gb))
}

# configure_and_build FOLDER TARGET... -- CMAKE OPTION...: only what changed is built again.
configure_and_build() {
  local folder=$1 targets=()
  shift
  while (($# > 0)) && [[ $1 != -- ]]; do
    targets+=("$1")
    shift
  done
  shift
  local log=$folder/configure.log
  mkdir -p "$folder"
  if ! run cmake -S "$ROOT" -B "$folder" -G Ninja "$@" >"$log" 2>&1; then
    cat "$log" >&2
    fail "the configuration failed; another Boost (1.81 or later) is named with -DBoost_ROOT=DIR or BOOST_ROOT=DIR"
  fi
  run cmake --build "$folder" -j "$(build_jobs)" ${targets[@]:+--target "${targets[@]}"} >&2
}

# install_dependencies [OPTION]: not to be killed half-way, so an interruption takes effect after it.
install_dependencies() {
  env -u RCBD_WORK -u TMPDIR "$ROOT/deploy/dependencies" "$@"
}

# begin_work NAME: a folder ($WORK) for sockets, data and temporary files of everything started from here on, and a
# mark in the environment ($RCBD_WORK) by which all of that is found again. It is ended, whatever happens, by end_work.
# A script that another one runs works in a folder of that one's, which ends what carries its mark.
begin_work() {
  unset RCBD_ENDPOINT RCBD_BIN_DIR RCBD_TOKEN RCBD_TOKEN_FILE
  trap end_work EXIT
  trap 'exit 130' INT
  trap 'exit 143' TERM HUP
  WORK=$(mktemp -d "${RCBD_WORK:-/tmp}/$1.XXXXXX")
  export RCBD_WORK=${RCBD_WORK:-$WORK} TMPDIR=$WORK
}

# The processes that carry the mark; only those of that name, if one is given. (grep itself must not carry it.)
marked() {
  local file pid name
  env -u RCBD_WORK grep -lszxF "RCBD_WORK=$WORK" /proc/[0-9]*/environ | while read -r file; do
    pid=${file#/proc/}
    pid=${pid%/environ}
    # A process may end while it is looked at.
    read -r name 2>/dev/null <"/proc/$pid/comm" || continue
    if [[ -z ${1:-} || $name == "$1" ]]; then echo "$pid"; fi
  done || true
}

# Nothing of this run stays: first the services' supervisors are told, which stop them cleanly, then all that is left
# is killed.
end_work() {
  trap '' INT TERM HUP
  local pids i
  if [[ $RCBD_WORK != "$WORK" ]]; then
    rm -rf "$WORK"
    return
  fi
  for ((i = 0; i < 100; ++i)); do
    pids=$(marked rcbd-supervisor)
    [[ -n $pids ]] || break
    # shellcheck disable=SC2086
    if ((i == 0)); then kill -TERM $pids 2>/dev/null || true; fi
    sleep 0.1
  done
  for ((i = 0; i < 50; ++i)); do
    pids=$(marked)
    [[ -n $pids ]] || break
    # shellcheck disable=SC2086
    kill -KILL $pids 2>/dev/null || true
    sleep 0.1
  done
  rm -rf "$WORK"
}

# can_be_apart, apart COMMAND...: as root, in namespaces of its own, which end with it, and with them all that it has started
# and mounted.
can_be_apart() {
  ((EUID == 0)) && unshare --mount --pid --ipc --fork --mount-proc true 2>/dev/null
}
apart() {
  run unshare --mount --pid --ipc --fork --kill-child --mount-proc "$@"
}

# run COMMAND...: as a child that this script can be interrupted over at any moment (a shell that waits for a command
# in the foreground handles its signals only after that one).
run() {
  "$@" &
  wait "$!"
}
