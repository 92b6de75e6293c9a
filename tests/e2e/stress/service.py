"""The service of a run: started as a user would, with the sanitizers' options; stopped, with a look at what is left."""
import glob
import os
import re
import signal
import subprocess
import time

from faults import FILLING
from fuzz import listeners
from sanitizers import environment
from support import free_port, processes_of


class Service:
    def __init__(self, programs, folder, data, ranks, patience):
        self.programs, self.folder, self.data, self.ranks, self.patience = programs, folder, data, ranks, patience
        self.endpoint = f"unix:{folder}/s"
        self.tcp = f"127.0.0.1:{free_port()}"
        self.reports = os.path.join(folder, "sanitizer")
        os.makedirs(self.reports)
        self.environment = {**os.environ, **environment(self.reports), "RCBD_ENDPOINT": self.endpoint,
                            "RCBD_LISTEN": self.tcp, "RCBD_BIN_DIR": programs,
                            "RCBD_SILENCE_SECONDS": str(15 * patience), "RCBD_STALL_SECONDS": str(120 * patience)}
        self.places = set()  # outside its own folder, that it has to remove

    def ctl(self, *arguments):
        return subprocess.run([os.path.join(self.programs, "rcbctl"), *map(str, arguments)], env=self.environment,
                              cwd=self.folder, stdin=subprocess.DEVNULL, capture_output=True, text=True,
                              timeout=120 * self.patience)

    def start(self):
        up = self.ctl("up", "-n", self.ranks, "--data-dir", self.data, "--deadline", 60 * self.patience,
                      *self.service_options())
        if up.returncode != 0:
            raise RuntimeError(f"rcbctl up: exit {up.returncode}: {up.stdout}{up.stderr}")

    def service_options(self):
        known = subprocess.run([os.path.join(self.programs, "rcbd"), "--help"], capture_output=True, text=True).stdout
        options = {"--keep-reports": 200, "--files-below": self.folder}
        return [word for name, value in options.items() if name in known for word in (name, value)]

    def note_places(self, pids):
        """Folders and sockets outside its own folder that the running service uses."""
        for place in listeners(pids):
            if place.startswith("unix:") and not place.startswith(self.endpoint):
                self.places.add(os.path.dirname(place[5:]) if "rcbd" in os.path.dirname(place) else place[5:])
        for _, line in processes_of(self.data):
            self.places |= set(re.findall(r"/dev/shm/\S+", line))

    def stop(self):
        """Stops it cleanly. Returns what was not as it should be."""
        wrong = []
        down = self.ctl("down", "--deadline", 60 * self.patience)
        if down.returncode != 0:
            wrong.append(f"rcbctl down: exit {down.returncode}: {down.stdout}{down.stderr}")
        end = time.monotonic() + 20 * self.patience
        while processes_of(self.data) and time.monotonic() < end:
            time.sleep(0.1)
        for pid, line in processes_of(self.data):
            wrong.append(f"still running: {pid} {line}")
            os.kill(pid, signal.SIGKILL)
        return wrong + self.left_behind()

    def left_behind(self):
        """Sockets and files that nobody needs any more."""
        left = glob.glob(f"{self.folder}/s") + glob.glob(f"{self.folder}/s.*")
        left += [place for place in sorted(self.places) if os.path.exists(place)]
        left += [name for name in os.listdir(self.data)
                 if not re.fullmatch(rf"rcbd\.log(\.\d+)?|clean-shutdown|lock|launch\.lock|token|scenes|{FILLING}", name)]
        return [f"left behind: {path}" for path in left]
