#!/usr/bin/env python3
"""Several machines on one, for tests and for trying things by hand: each has its own network, host name, /tmp,
/dev/shm and IPC, and all are on one bridge. They end with this process; close() also ends what runs on them. Needs
root.

    tests/hosts/hosts.py 3 -- COMMAND   runs COMMAND on machine a of a, b and c; $HOSTS_AGENT is a remote shell for mpirun

With a switch of our own (the program rcb_switch) in the bridge's place, each machine's link has a delay, a loss and a
bandwidth, which may change at any time:

    tests/hosts/hosts.py 3 --switch build/release/bin/rcb_switch --delay 0.0005 --rate 1e9 -- COMMAND
"""
import argparse
import contextlib
import ctypes
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time

NETWORK = "10.77.0"
NAMES = "abcdefgh"
ENDS_WITH_US = ["setpriv", "--pdeathsig", "KILL"]


class Hosts:
    """machines[k] is named by its letter and has the address 10.77.0.k+1. A folder (`shared`) is the same on all."""

    def __init__(self, count, switch=None):
        self.program, self.links = switch, None
        self.names = list(NAMES[:count])
        self.shared = tempfile.mkdtemp(prefix="rcb-hosts-", dir="/var/tmp")
        self.agent = os.path.join(self.shared, "agent")
        self.holders = {}
        self.switch = subprocess.Popen([*ENDS_WITH_US, "unshare", "--net", "sleep", "infinity"])
        try:
            self._set_up()
        except BaseException:
            self.close()
            raise

    def _set_up(self):
        names = os.path.join(self.shared, "etc-hosts")
        with open(names, "w") as file:
            file.write("127.0.0.1 localhost\n" + "".join(f"{self.address(name)} {name}\n" for name in self.names))
        for name in self.names:
            script = ("set -e; mount -t tmpfs none /tmp; mount -t tmpfs none /dev/shm; "
                      f"mount --bind {names} /etc/hosts; "
                      f"hostname {name}; ip link set lo up; exec sleep infinity")
            self.holders[name] = subprocess.Popen(
                [*ENDS_WITH_US, "unshare", "--net", "--uts", "--mount", "--ipc", "--propagation", "private", "sh", "-c",
                 script])
        for name, holder in list(self.holders.items()) + [(None, self.switch)]:
            self._wait_for(holder, ["sleep", "infinity"])
        if not self.program:
            self._in_switch("ip link add bridge type bridge && ip link set bridge up")
        for number, name in enumerate(self.names, 1):
            self._in_switch(f"ip link add port-{name} type veth peer name eth0 netns {self.holders[name].pid} && "
                            + (f"echo 1 >/proc/sys/net/ipv6/conf/port-{name}/disable_ipv6" if self.program else
                               f"ip link set port-{name} master bridge") + f" && ip link set port-{name} up")
            script = f"ip addr add {NETWORK}.{number}/24 dev eth0 && ip link set eth0 up"
            if self.program:  # BBR, some kernels' choice, goes for 10 s by a round trip from before the link changed
                script += " && echo reno >/proc/sys/net/ipv4/tcp_congestion_control"
            self.run(name, "sh", "-c", script, check=True)
        if self.program:
            self.links = subprocess.Popen(
                [*ENDS_WITH_US, "nsenter", "-t", str(self.switch.pid), "-n", self.program,
                 *(f"port-{name}" for name in self.names)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            self._answer("ready")
        with open(self.agent, "w") as file:
            file.write("#!/bin/sh\n# A remote shell between these machines: agent NAME COMMAND\n"
                       "case $1 in\n")
            for name, holder in self.holders.items():
                file.write(f"{name}) pid={holder.pid} ;;\n")
            file.write('*) echo "no machine $1" >&2; exit 1 ;;\nesac\nshift\n'
                       'exec nsenter -t "$pid" -n -u -m -i env -i HOME="$HOME" PATH="$PATH" sh -c "$*"\n')
        os.chmod(self.agent, 0o700)

    @staticmethod
    def _wait_for(holder, arguments):
        end = time.monotonic() + 20
        while time.monotonic() < end:
            with open(f"/proc/{holder.pid}/cmdline") as file:
                if file.read().split("\0")[:2] == arguments:
                    return
            if holder.poll() is not None:
                break
            time.sleep(0.01)
        raise RuntimeError("a machine could not be made")

    def _in_switch(self, script):
        subprocess.run(["nsenter", "-t", str(self.switch.pid), "-n", "sh", "-c", script], check=True)

    @contextlib.contextmanager
    def network(self, name):
        """Sockets that this thread makes meanwhile are that machine's, and stay so."""
        libc, net = ctypes.CDLL(None, use_errno=True), 0x40000000  # CLONE_NEWNET
        with open("/proc/thread-self/ns/net") as own, open(f"/proc/{self.holders[name].pid}/ns/net") as other:
            if libc.setns(other.fileno(), net) != 0:
                raise OSError(ctypes.get_errno(), "setns")
            try:
                yield
            finally:
                libc.setns(own.fileno(), net)

    def address(self, name):
        return f"{NETWORK}.{self.names.index(name) + 1}"

    def command(self, name, *args):
        return ["nsenter", "-t", str(self.holders[name].pid), "-n", "-u", "-m", "-i", *map(str, args)]

    def environment(self, **more):
        """For what starts mpirun on a machine."""
        kept = {name: value for name, value in os.environ.items()
                if not name.startswith(("RCBD_", "OMPI_")) and name != "XDG_RUNTIME_DIR"}
        return kept | {"OMPI_MCA_plm_rsh_agent": self.agent, "TMPDIR": "/tmp",
                       "XDG_STATE_HOME": os.path.join(self.shared, "state")} | more

    def run(self, name, *args, **kwargs):
        kwargs.setdefault("env", self.environment())
        return subprocess.run(self.command(name, *args), stdin=subprocess.DEVNULL, **kwargs)

    def link(self, name, state):
        """Pulls a machine's cable (`down`), or puts it back (`up`)."""
        self._in_switch(f"ip link set port-{name} {state}")

    def _answer(self, expected=None):
        answer = self.links.stdout.readline().strip()
        if not answer or expected not in (None, answer):
            raise RuntimeError(f"the switch answers {answer!r}")
        return answer

    def set_link(self, name, delay=0, loss=0, rate=0):
        """Of each direction of a machine's link: seconds, share of the frames, bits/s (0: no limit)."""
        self.links.stdin.write(f"set port-{name} {delay:.9f} {loss} {rate}\n")
        self.links.stdin.flush()
        self._answer("ok")

    def counts(self):
        """What the switch has carried: the longest chain of messages that waited for each other, and for each machine
        what it has sent and received, in frames and bytes, and how many frames its link has lost."""
        self.links.stdin.write("count\n")
        self.links.stdin.flush()
        chain, *rest = map(int, self._answer().split())
        fields = ("frames_sent", "bytes_sent", "frames_received", "bytes_received", "lost")
        return chain, {name: dict(zip(fields, rest[5 * k:])) for k, name in enumerate(self.names)}

    def processes(self, name):
        """Those of a machine, by number, but for the one that holds it."""
        found = []
        try:
            own = os.readlink(f"/proc/{self.holders[name].pid}/ns/uts")
        except OSError:
            return found
        if own == os.readlink("/proc/self/ns/uts"):  # it isn't a machine of its own yet
            return found
        for pid in filter(str.isdigit, os.listdir("/proc")):
            try:
                if os.readlink(f"/proc/{pid}/ns/uts") == own and int(pid) != self.holders[name].pid:
                    found.append(int(pid))
            except OSError:
                continue
        return found

    def kill(self, name):
        """Every process of a machine, as when it loses its power."""
        for pid in self.processes(name):
            try:
                os.kill(pid, 9)
            except ProcessLookupError:
                continue

    def close(self):
        for name in list(self.holders):
            for _ in range(20):
                if not self.processes(name):
                    break
                self.kill(name)
                time.sleep(0.05)
        for holder in [*self.holders.values(), self.switch, *filter(None, [self.links])]:
            with holder:  # closes its pipes
                holder.kill()
        shutil.rmtree(self.shared, ignore_errors=True)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int, choices=range(1, len(NAMES) + 1))
    parser.add_argument("--switch", metavar="PROGRAM")
    parser.add_argument("--delay", type=float, default=0, help="of each link, in seconds; two lie between two machines")
    parser.add_argument("--loss", type=float, default=0, help="share of the frames that a link loses")
    parser.add_argument("--rate", type=float, default=0, help="of each link, in bits/s")
    parser.add_argument("command", nargs="+")
    told = parser.parse_args()
    with Hosts(told.count, told.switch) as hosts:
        for name in hosts.names if told.switch else ():
            hosts.set_link(name, told.delay, told.loss, told.rate)
        environment = hosts.environment(HOSTS_AGENT=hosts.agent)
        print(f"machines {', '.join(f'{name} {hosts.address(name)}' for name in hosts.names)}; shared folder "
              f"{hosts.shared}; on another: {shlex.quote(hosts.agent)} b COMMAND", file=sys.stderr)
        return subprocess.run(hosts.command(hosts.names[0], *told.command), env=environment).returncode


if __name__ == "__main__":
    sys.exit(main())
