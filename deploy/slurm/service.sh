#!/bin/bash
# A service on the machines of its own job; solvers find it by the file WHERE, in a folder that all machines have:
#   sbatch --nodes=2 --ntasks=16 --export=ALL,WHERE=$HOME/rcbd.where deploy/slurm/service.sh
# It has one rank per task, so --ntasks-per-node=1 gives one on each machine. `scancel JOB`, and `rcbctl down --endpoint file:$WHERE`, end it cleanly.
#SBATCH --job-name=rcbd
#SBATCH --output=rcbd-%j.out
#SBATCH --requeue
set -eu
: "${WHERE:?the file that is to say where the service is, for example \$HOME/rcbd.where}"
# sbatch runs a copy of this script, so the programs are looked for in PATH unless this names their folder.
[[ -z ${RCBD_BIN_DIR:-} ]] || PATH=$RCBD_BIN_DIR:$PATH
# Log, token and scenes; next to WHERE, since clients read the token there. Another folder each time that Slurm starts the
# job again, with a copy of the scenes: a node that has died may still hold the locks in the old one.
count=${SLURM_RESTART_COUNT:-0}
data=$WHERE.data.$count
if ((count > 0)) && [[ -d $WHERE.data.$((count - 1))/scenes && ! -e $data ]]; then
  mkdir -m 700 "$data"
  cp -a "$WHERE.data.$((count - 1))/scenes" "$data/"
fi
export XDG_STATE_HOME=$data/state # not in the home, where each port would leave a folder
# A free port at each start: jobs on one machine don't get in each other's way, and clients read it in WHERE.
port=$(python3 -c 'import socket; s = socket.socket(); s.bind(("", 0)); print(s.getsockname()[1])')
# The ranks' traffic is MPI's, which isn't encrypted; clients' connections are.
exec rcbctl up --foreground --endpoint "$(hostname):$port" --data-dir "$data" --publish "$WHERE" --trusted-interconnect "$@"
