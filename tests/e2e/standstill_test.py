"""A disk that stands still, as a network home does whose server is away: who asks for its files waits, nobody else."""
import ctypes
import threading

from seat_client import Seat
from protocol_client import Client
from support import *

SILENCE = 4  # seconds; a rank that is silent for so long ends the service
ENVIRONMENT = {**os.environ, "RCBD_SILENCE_SECONDS": str(SILENCE)}


class StillDisk:
    """A file system that nobody serves over a folder: each call there hangs, until leave()."""
    libc = ctypes.CDLL(None, use_errno=True)

    def __init__(self, folder):
        self.folder = folder.encode()
        self.fuse = os.open("/dev/fuse", os.O_RDWR)
        options = f"fd={self.fuse},rootmode=40000,user_id=0,group_id=0".encode()
        if self.libc.mount(b"dead", self.folder, b"fuse", 0, options) != 0:
            os.close(self.fuse)
            raise OSError(ctypes.get_errno(), "mount")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        os.close(self.fuse)  # what hangs there fails now
        self.libc.umount2(self.folder, 2)


class Standstill(unittest.TestCase):
    def setUp(self):
        if os.geteuid() != 0 or not os.path.exists("/dev/fuse"):
            print("SKIPPED: only root can mount a disk that stands still", file=sys.stderr)
            self.skipTest("only root can mount a disk that stands still")

    def still(self, folder):
        try:
            return StillDisk(folder)
        except OSError as fault:
            print("SKIPPED:", fault, file=sys.stderr)
            self.skipTest(str(fault))

    def test_the_data_directory_holds_up_nobody(self):
        with Service(2, options=("--keep-reports", 10), env=ENVIRONMENT) as service:
            ranks = service.processes("rcbd")
            control, other = (Client(service.endpoint[5:], timeout=60) for _ in range(2))
            for scene in ("single", "team"):
                control.ask("scene.create", scene=scene, parts=4)
            team = [Seat(service.endpoint[5:], "team", k, 2, timeout=60) for k in range(2)]
            points = np.random.default_rng(1).random((200, 3))

            def step(number):
                control.push("single", number, points)
                for k, one in enumerate(team):
                    one.start(number, np.arange(k, 200, 2), points)
                for one in team:
                    self.assertEqual(one.finish()[0]["report"]["step"], number)

            def ask_history():  # older reports are on the disk: this one waits
                other.ask("history", scene="single")

            for number in range(50):
                step(number)
            with self.still(service.data):
                asking = threading.Thread(target=ask_history)
                asking.start()
                end = time.time() + 2.5 * SILENCE
                number = 50
                while time.time() < end:
                    step(number)
                    number += 1
                    self.assertEqual(control.ask("status")[0]["ranks"], 2)
                    time.sleep(0.05)
                self.assertGreater(number, 60)
                control.ask("scene.drop", scene="single")  # with its file
            asking.join(60)
            self.assertFalse(asking.is_alive())
            self.assertEqual(service.processes("rcbd"), ranks)

    def test_clients_files_hold_up_their_commands_alone(self):
        with Service(2, cwd=tempfile.gettempdir(), env=ENVIRONMENT) as service:
            ranks = service.processes("rcbd")
            folder = os.path.join(service.dir, "files")
            os.mkdir(folder)
            control, other = (Client(service.endpoint[5:], timeout=60) for _ in range(2))
            for scene in ("written", "single", "loaded"):
                control.ask("scene.create", scene=scene, parts=4)
            points = np.random.default_rng(1).random((200, 3))
            for scene in ("written", "single"):
                control.push(scene, 0, points)
            commands = {"write_parts": {"scene": "written", "directory": folder},
                        "load": {"scene": "loaded", "path": os.path.join(folder, "points.csv")}}
            number = 0
            for command, arguments in commands.items():
                codes = []

                def ask():
                    try:
                        other.ask(command, deadline_seconds=1, **arguments)
                    except Exception as refused:  # whatever it is, it is looked at below
                        codes.append(refused.args[0])

                with self.subTest(command), self.still(folder):
                    asking = threading.Thread(target=ask)
                    asking.start()
                    end = time.time() + 2
                    while time.time() < end:
                        number += 1
                        control.push("single", number, points)
                    asking.join(60)
                    self.assertEqual(codes, ["deadline_exceeded"])
            self.assertEqual(service.processes("rcbd"), ranks)
            # The disk moves again.
            written = other.ask("write_parts", scene="written", directory=folder)[0]
            self.assertEqual(len(written["files"]), 4)
            self.assertEqual(len(os.listdir(folder)), 4)


if __name__ == "__main__":
    unittest.main()
