#!/bin/bash
# A solver in a job of its own, beside the service of service.sh; it waits until that is up:
#   sbatch --export=ALL,WHERE=$HOME/rcbd.where deploy/slurm/solver.sh two_spheres --steps 200
#SBATCH --job-name=solver
#SBATCH --output=solver-%j.out
set -eu
: "${WHERE:?the file that says where the service is}"
[[ -z ${RCBD_BIN_DIR:-} ]] || PATH=$RCBD_BIN_DIR:$PATH
export RCBD_ENDPOINT=file:$WHERE
for ((second = 0; second < ${WAIT_SECONDS:-600}; ++second)); do
  if rcbctl status >/dev/null 2>&1; then exec "$@"; fi
  if ((second % 60 == 0)); then echo "waiting for the service of $WHERE" >&2; fi
  sleep 1
done
rcbctl status  # says why there is none
