#!/bin/bash
# A service and a solver in one job, on the same machines; the service ends with the solver:
#   sbatch --nodes=2 --ntasks=16 deploy/slurm/both.sh slope_mpi --points 1000000
# The solver is started by mpirun with as many processes as the job has tasks; a serial one: SERIAL=1. The service has one
# rank on each machine, or RANKS_PER_NODE: sbatch --export=ALL,RANKS_PER_NODE=2 ...
#SBATCH --job-name=solver
#SBATCH --output=solver-%j.out
set -eu
[[ -z ${RCBD_BIN_DIR:-} ]] || PATH=$RCBD_BIN_DIR:$PATH
folder=$(mktemp -d "${SLURM_SUBMIT_DIR:-$PWD}/rcbd-$SLURM_JOB_ID-XXXX") # where all machines see it
port=$(python3 -c 'import socket; s = socket.socket(); s.bind(("", 0)); print(s.getsockname()[1])')
export RCBD_ENDPOINT=file:$folder/where XDG_STATE_HOME=$folder/state
# The same order of machines as that of the solver's processes, so that most particles stay on their own machine.
hosts=$(scontrol show hostnames | sed "s/\$/:${RANKS_PER_NODE:-1}/" | paste -sd,)
# --foreground: as a child of this script the service gets the SIGTERM that scancel sends to all processes of the job.
rcbctl up --foreground --hosts "$hosts" --endpoint "$(hostname):$port" --data-dir "$folder/data" \
  --publish "$folder/where" --trusted-interconnect &
service=$!
trap 'kill $service 2>/dev/null || true; wait $service || true; rm -rf "$folder"' EXIT
trap 'exit 143' TERM
until rcbctl status >/dev/null 2>&1; do
  kill -0 $service # ends the script if the service couldn't start
  sleep 0.2
done
if [[ -n ${SERIAL:-} ]]; then
  "$@" &
else
  mpirun --bind-to none --oversubscribe -x RCBD_ENDPOINT "$@" &
fi
wait $! # which, unlike a program in the foreground, lets the traps run at once
