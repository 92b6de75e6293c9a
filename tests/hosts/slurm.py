#!/usr/bin/env python3
"""A Slurm cluster on the machines of hosts.py, for tests and for trying things by hand: the controller on machine a, a
node on each. Ends with this process. Needs root, and the packages slurm-wlm and munge.

    tests/hosts/slurm.py 3 -- COMMAND   runs COMMAND on machine a of a, b and c, where sbatch and squeue work
"""
import contextlib
import os
import shutil
import subprocess
import sys
import time

from hosts import ENDS_WITH_US, Hosts

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch")
SETTINGS = """ClusterName=machines
SlurmctldHost={first}({address})
AuthType=auth/munge
AuthInfo=socket=/tmp/munge/socket
SlurmUser=root
SlurmdUser=root
StateSaveLocation={folder}/state
SlurmdSpoolDir=/tmp/slurmd
SlurmctldPidFile=/tmp/slurmctld.pid
SlurmdPidFile=/tmp/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/linear
SlurmdParameters=config_overrides
ReturnToService=2
SlurmdTimeout=6
KillWait=15
SchedulerParameters=batch_sched_delay=0,sched_interval=1
{nodes}
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def missing():
    """The programs of Slurm that this computer lacks."""
    return [name for name in PROGRAMS if shutil.which(name, path=os.environ["PATH"] + ":/usr/sbin:/sbin") is None]


class Cluster(Hosts):
    """Each node has room for `tasks`."""

    def __init__(self, count, tasks=4):
        self.daemons = {}
        super().__init__(count)
        try:
            self._start(tasks)
        except BaseException:
            self.close()
            raise

    def _start(self, tasks):
        self.folder = os.path.join(self.shared, "slurm")
        os.makedirs(os.path.join(self.folder, "state"))
        nodes = "\n".join(f"NodeName={name} NodeAddr={self.address(name)} CPUs={tasks} State=UNKNOWN"
                          for name in self.names)
        with open(os.path.join(self.folder, "slurm.conf"), "w") as file:
            file.write(SETTINGS.format(first=self.names[0], address=self.address(self.names[0]), folder=self.folder,
                                       nodes=nodes))
        self.key = os.path.join(self.folder, "munge.key")
        with open(os.open(self.key, os.O_CREAT | os.O_WRONLY, 0o600), "wb") as file:
            file.write(os.urandom(1024))
        for name in self.names:
            self._start_munge(name)
        self._daemon(self.names[0], "slurmctld", "-D")
        for name in self.names:
            self._daemon(name, "slurmd", "-D", "-N", name)
        self.wait_for(lambda: self.slurm("sinfo", "-h", "-N", "-o", "%T").split() == ["idle"] * len(self.names),
                      "the nodes to be idle")

    def _start_munge(self, name):
        self.run(name, "mkdir", "-p", "/tmp/munge", check=True)
        self._daemon(name, "munged", "--foreground", "--force", f"--key-file={self.key}", "--socket=/tmp/munge/socket",
                     "--pid-file=/tmp/munge/pid", "--log-file=/tmp/munge/log", "--seed-file=/tmp/munge/seed")
        self.wait_for(lambda: self.run(name, "test", "-S", "/tmp/munge/socket").returncode == 0, f"munge on {name}")

    def _daemon(self, name, *args):
        with open(os.path.join(self.folder, f"{args[0]}-{name}.log"), "ab") as log:
            self.daemons[args[0], name] = subprocess.Popen(
                [*ENDS_WITH_US, *self.command(name, *args)], env=self.environment(), stdin=subprocess.DEVNULL,
                stdout=log, stderr=log)

    def start_node(self, name):
        """Again, after kill()."""
        self._start_munge(name)
        self._daemon(name, "slurmd", "-D", "-N", name)

    def environment(self, **more):
        path = os.environ["PATH"] + ":/usr/sbin:/sbin"
        return super().environment(PATH=path, SLURM_CONF=os.path.join(self.shared, "slurm", "slurm.conf")) | more

    def slurm(self, *args, name=None, **more):
        """What a command of Slurm prints; more: environment variables."""
        done = self.run(name or self.names[0], "env", "-C", self.shared, *args, capture_output=True, text=True,
                        timeout=60, env=self.environment(**more))
        return done.stdout

    def state(self, job):
        """PENDING, RUNNING ...; empty where it has gone."""
        return self.slurm("squeue", "-h", "-j", job, "-o", "%T").strip()

    def wait_for(self, true, what, seconds=60):
        end = time.monotonic() + seconds
        while not true():
            if time.monotonic() > end:
                raise TimeoutError(f"waited {seconds} s for {what}\n{self.logs()}")
            time.sleep(0.1)

    def logs(self):
        """What tells most about jobs that don't go as they should comes first: reports of failed tests are cut short."""
        texts = [self.slurm("squeue", "-o", "%i %j %T %r %N %S"), self.slurm("scontrol", "-o", "show", "nodes")]
        outputs = [os.path.join(self.shared, name) for name in sorted(os.listdir(self.shared)) if name.endswith(".out")]
        daemons = [f"{program}-{name}.log" for program in ("slurmctld", "slurmd", "munged") for name in self.names]
        for path in outputs + [os.path.join(self.folder, name) for name in daemons]:
            with contextlib.suppress(OSError), open(path, errors="replace") as file:
                texts.append(f"{os.path.basename(path)}:\n{file.read()[-1500:]}")
        return "\n".join(texts)

    def close(self):
        super().close()
        for daemon in self.daemons.values():
            daemon.kill()
            daemon.wait()


def main():
    if len(sys.argv) < 4 or not sys.argv[1].isdigit() or sys.argv[2] != "--":
        sys.exit(__doc__)
    if missing():
        sys.exit(f"no {', '.join(missing())}: apt install slurm-wlm munge")
    with Cluster(int(sys.argv[1])) as cluster:
        print(f"nodes {', '.join(cluster.names)}; shared folder {cluster.shared}", file=sys.stderr)
        return subprocess.run(cluster.command(cluster.names[0], *sys.argv[3:]), env=cluster.environment()).returncode


if __name__ == "__main__":
    sys.exit(main())
