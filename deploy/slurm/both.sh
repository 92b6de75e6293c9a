#!/bin/bash
# A service and a solver in one job, on the same machines; the service ends with the solver:
#   sbatch --nodes=2 --ntasks=16 deploy/slurm/both.sh slope_mpi --points 1000000
# The solver is started by mpirun with as many processes as the job has tasks; a serial one: SERIAL=1.
#SBATCH --job-name=solver
#SBATCH --output=solver-%j.out
set -eu
[[ -z ${RCBD_BIN_DIR:-} ]] || PATH=$RCBD_BIN_DIR:$PATH
folder=$(mktemp -d "${SLURM_SUBMIT_DIR:-$PWD}/rcbd-$SLURM_JOB_ID-XXXX") # where all machines see it
port=$(python3 -c 'import socket; s = socket.socket(); s.bind(("", 0)); print(s.getsockname()[1])')
export RCBD_ENDPOINT=file:$folder/where
export SLURM_OVERLAP=1 # the solver's processes and the service's share the machines
rcbctl up --endpoint "$(hostname):$port" --data-dir "$folder/data" --publish "$folder/where" --trusted-interconnect
trap 'rcbctl down; rm -rf "$folder"' EXIT
if [[ -n ${SERIAL:-} ]]; then
  "$@"
else
  mpirun --bind-to none --oversubscribe -x RCBD_ENDPOINT "$@"
fi
