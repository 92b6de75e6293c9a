"""Trajectories of other programs: LAMMPS dumps and XYZ files of many frames, from files, pipes and FIFOs, as they come; and
a real LAMMPS run that drives the service, unmodified."""
import gzip
import threading

from support import *

LMP = shutil.which("lmp")


def dump(timestep, ids, points, columns="id x y z", bounds=((0, 1),) * 3):
    rows = "".join(f"{i} " + " ".join(f"{v:.17g}" for v in point) + "\n" for i, point in zip(ids, points))
    box = "".join(f"{lo:.17g} {hi:.17g}\n" for lo, hi in bounds)
    return (f"ITEM: TIMESTEP\n{timestep}\nITEM: NUMBER OF ATOMS\n{len(ids)}\nITEM: BOX BOUNDS pp pp pp\n{box}"
            f"ITEM: ATOMS {columns}\n{rows}")


def xyz(points):
    return f"{len(points)}\ncomment\n" + "".join("A " + " ".join(f"{v:.17g}" for v in p) + "\n" for p in points)


class Trajectories(ServiceTest):
    """Frames of about 200 particles in any order; some leave and some enter."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.rng = np.random.default_rng(40)
        cls.frames = []  # (timestep, ids, points)
        points = cls.rng.random((260, 3))
        for k in range(5):
            points = points + cls.rng.normal(0, 0.02, points.shape)
            here = cls.rng.permutation(np.arange(10 * k, 200 + 15 * k) if k < 4 else np.arange(30, 245))
            cls.frames.append((100 * k, here + 1, points[here]))
        cls.dump = "".join(dump(*frame) for frame in cls.frames)
        cls.xyz = "".join(xyz(cls.frames[0][2] + 0.01 * k) for k in range(4))

    def write(self, name, text):
        path = os.path.join(self.dir, name)
        with open(path, "wb") as file:
            file.write(text if isinstance(text, bytes) else text.encode())
        return path

    def fifo(self, name="run.fifo"):
        path = os.path.join(self.dir, name)
        if os.path.exists(path):
            os.unlink(path)
        os.mkfifo(path)
        return path

    def stream(self, *args, stdin=subprocess.DEVNULL):
        return subprocess.Popen([RCBCTL, "stream", *map(str, args)], stdin=stdin, stdout=subprocess.PIPE,
                                stderr=subprocess.PIPE, text=True,
                                env=dict(os.environ, RCBD_ENDPOINT=self.service.endpoint))

    def ended(self, process, code=0):
        out, err = process.communicate(timeout=120)
        self.assertEqual(process.returncode, code, out + (err or ""))
        return out, err

    def steps(self, name):
        return [report["step"] for report in self.service.json("history", name)]

    def held(self, name):
        """{id: position} as the service has them."""
        folder = os.path.join(self.dir, "export-" + name)
        self.service.json("export", name, folder, "--format", "npy", "--replace")
        return np.load(os.path.join(folder, "id.npy")), np.load(os.path.join(folder, "positions.npy"))

    def check_held(self, name, frame):
        ids, points = self.held(name)
        order = np.argsort(frame[1])
        np.testing.assert_array_equal(ids, frame[1][order])
        np.testing.assert_array_equal(points, frame[2][order])


class Stream(Trajectories):
    def test_replay_takes_all_frames_while_particles_come_and_go(self):
        for name, path in (("plain", self.write("run.lammpstrj", self.dump)),
                           ("packed", self.write("run.lammpstrj.gz", gzip.compress(self.dump.encode())))):
            report = self.service.json("replay", name, path, "--parts", 5, "--tolerance", 0.1)
            self.assertEqual(report["steps"], 5)
            history = self.service.json("history", name)
            self.assertEqual([r["step"] for r in history], list(range(5)))
            self.assertEqual([r["n"] for r in history], [len(ids) for _, ids, _ in self.frames])
            self.assertEqual([(r["inserted"], r["removed"]) for r in history[1:]],
                             [(len(set(b[1]) - set(a[1])), len(set(a[1]) - set(b[1])))
                              for a, b in zip(self.frames, self.frames[1:])])
            self.check_held(name, self.frames[-1])

    def test_one_frame_for_the_commands_of_one_file(self):
        one = self.write("one.dump", dump(*self.frames[0]))
        ids, points = self.frames[0][1:]
        same = self.write("one.csv", "id,x,y,z\n" + "".join(
            f"{i}," + ",".join(f"{v:.17g}" for v in p) + "\n" for i, p in zip(ids, points)))
        scaled = self.write("scaled.dump.gz", gzip.compress(dump(
            0, ids, points / [2, 4, 8] + [0.5, 0.5, 0.5], "id xs ys zs", ((-1, 1), (-2, 2), (-4, 4))).encode()))
        wanted = self.service.json("partition", same, "--parts", 7)
        part = {}
        for path in (one, same):
            out = os.path.join(self.dir, "part.npy")
            got = self.service.json("partition", path, "--parts", 7, "--assign", out)
            self.assertEqual(got["hash"], wanted["hash"])
            part[path] = np.load(out)
        np.testing.assert_array_equal(part[one], part[same])
        with open(one) as file:  # standard input
            out = os.path.join(self.dir, "piped.npy")
            done = subprocess.run([RCBCTL, "partition", "-", "--parts", "7", "--assign", out, "--json"], stdin=file,
                                  capture_output=True, text=True, timeout=120,
                                  env=dict(os.environ, RCBD_ENDPOINT=self.service.endpoint))
        self.assertEqual(json.loads(done.stdout)["hash"], wanted["hash"])
        np.testing.assert_array_equal(np.load(out), part[one])
        self.assertEqual(self.service.json("partition", scaled, "--parts", 7)["n"], 200)
        self.assertEqual(self.service.json("compare", one, "--parts", 3)["n"], 200)
        self.assertEqual(self.service.json("partition", one, "--parts", 7, "--ranks", 2)["hash"], wanted["hash"])
        flat = self.service.json("partition", one, "--parts", 7, "--dims", 2)
        self.assertEqual(flat["dims"], 2)
        self.service.json("scene", "create", "one", "--parts", 7)
        self.assertEqual(self.service.json("push", "one", one)["n"], 200)
        many = self.write("many.dump", self.dump)
        for command in (("partition", many, "--parts", 2), ("push", "one", many), ("compare", many, "--parts", 2)):
            self.assertIn("rcbctl replay pushes a trajectory", self.service.failure(*command)["hint"])

    def test_frames_are_pushed_as_they_come(self):
        """Its step is there before the next frame is written."""
        for format, texts in (("lammpstrj", [dump(*frame) for frame in self.frames]),
                              ("xyz", [xyz(self.frames[0][2] + 0.01 * k) for k in range(3)])):
            fifo, name = self.fifo(), "live-" + format
            process = self.stream(name, "--parts", 4, "--format", format, fifo, "--json")
            with open(fifo, "w") as file:
                for k, text in enumerate(texts):
                    for piece in (text[:100], text[100:]):
                        file.write(piece)
                        file.flush()
                    awaited(lambda: self.service.ctl("scene", "show", name).returncode == 0
                            and len(self.steps(name)) == k + 1)
            out, _ = self.ended(process)
            self.assertEqual(json.loads(out)["steps"], len(texts))
            self.assertEqual(self.steps(name), [100 * k for k in range(5)] if format == "lammpstrj" else [0, 1, 2])
        self.check_held("live-lammpstrj", self.frames[-1])

    def test_a_scene_is_gone_on_with_or_made(self):
        first = self.write("first.dump", "".join(dump(*frame) for frame in self.frames[:2]))
        rest = self.write("rest.dump", "".join(dump(*frame) for frame in self.frames[2:]))
        for args in (("--parts", 3), ()):
            self.ended(self.stream("on", first if args else rest, *args))
        self.assertEqual(self.steps("on"), [0, 100, 200, 300, 400])
        self.check_held("on", self.frames[-1])
        self.assertEqual(self.service.json("scene", "show", "on")["parts"], 3)
        # Timesteps that begin anew get the next numbers.
        _, err = self.ended(self.stream("on", first))
        self.assertIn("timestep 0 comes behind step 400", err)
        self.assertEqual(self.steps("on")[5:], [401, 402])
        failure = self.service.failure("stream", "on", "--parts", 5, first)
        self.assertEqual(failure["code"], "already_exists")
        self.assertIn("--replace", failure["hint"])
        history = os.path.join(self.dir, "on.csv")
        self.service.json("stream", "on", "--parts", 5, "--replace", "--history", history, first)
        self.assertEqual(self.steps("on"), [0, 100])
        self.assertEqual(len(text_of(history).splitlines()), 3)

    def test_weights_and_an_empty_beginning(self):
        text = dump(0, [], [], "id x y z mass") + dump(50, [1, 2, 3], [[0, 0, 0, 2], [1, 0, 0, 3], [2, 0, 0, 4]],
                                                       "id x y z mass")
        text += dump(100, [4, 3, 2], [[5, 0, 0, 9], [2, 0, 0, 4], [1, 0, 0, 3]], "id x y z mass")
        self.service.json("stream", "heavy", "--parts", 2, "--weights", "mass", self.write("heavy.dump", text))
        self.assertEqual(self.steps("heavy"), [50, 100])
        shown = self.service.json("scene", "show", "heavy")
        self.assertEqual(sum(shown["loads"]), 16)

    def test_what_ends_too_early_or_is_wrong(self):
        cut = self.dump[:-5]
        done = self.service.ctl("replay", "cut", self.write("cut.dump", cut), "--parts", 2, check=True)
        self.assertIn("cut.dump: ends within frame 4 (timestep 400)", done.stderr)
        self.assertEqual(len(self.steps("cut")), 4)
        process = self.stream("cut-pipe", "--parts", 2, "-", stdin=subprocess.PIPE)
        process.stdin.write(cut)
        process.stdin.close()
        process.stdin = None
        _, err = self.ended(process, 1)
        self.assertIn("standard input: ends within frame 4 (timestep 400)", err)
        self.assertIn("the 4 steps before stand in scene 'cut-pipe'", err)
        self.assertEqual(len(self.steps("cut-pipe")), 4)
        wrong = self.write("wrong.dump", self.dump.replace("ITEM: TIMESTEP\n300", "ITEM: TIMESTEP\n3x0"))
        self.assertIn("wrong.dump:", self.service.failure("stream", "wrong", "--parts", 2, wrong)["message"])
        self.assertEqual(self.steps("wrong"), [0, 100, 200])
        anonymous = self.write("anonymous.xyz", self.xyz + xyz(self.frames[0][2][:-1]))
        failure = self.service.failure("replay", "anonymous", anonymous, "--parts", 2)
        self.assertIn("frame 4 (step 4): 199 rows, and the step before had 200", failure["message"])
        self.assertEqual(self.service.failure("stream", "none", "--format", "xyz", "/nonexistent")["code"], "not_found")
        csv = self.write("points.csv", "x,y,z\n1,2,3\n")
        self.assertIn("neither a LAMMPS dump nor an XYZ", self.service.failure("stream", "none", csv)["message"])

    def test_ctrl_c_says_where_it_stood(self):
        history = os.path.join(self.dir, "stopped.csv")
        process = self.stream("stopped", "--parts", 2, "--history", history, "-", stdin=subprocess.PIPE)
        process.stdin.write(dump(*self.frames[0]) + dump(*self.frames[1]))
        process.stdin.flush()
        awaited(lambda: self.service.ctl("scene", "show", "stopped").returncode == 0
                and len(self.steps("stopped")) == 2)
        failure = self.service.failure("stream", "stopped", self.write("late.dump", dump(*self.frames[2])))
        self.assertEqual(failure["code"], "busy")
        process.send_signal(signal.SIGINT)  # while it waits for a third
        self.assertEqual(process.wait(60), 130)
        err = process.stderr.read()
        self.assertIn("interrupted after 2 steps, which stand in scene 'stopped'", err)
        self.assertEqual(len(text_of(history).splitlines()), 3)
        process.stdin.close()
        process.stdout.close()
        process.stderr.close()

    def test_without_a_service_the_fifo_is_not_opened(self):
        """So that its writer doesn't start to write for nobody."""
        fifo = self.fifo()
        done = run("stream", "s", fifo, endpoint="unix:/nonexistent/rcbd.sock")
        self.assertEqual(done.returncode, 3)
        with self.assertRaises(OSError):  # ENXIO: nobody reads
            os.open(fifo, os.O_WRONLY | os.O_NONBLOCK)


@unittest.skipUnless(LMP, "lmp, of Debian's package lammps, isn't installed")
class Lammps(Trajectories):
    """The same with a LAMMPS run, which knows nothing of the service."""

    def lammps(self, *dumps):
        folder = tempfile.mkdtemp(dir=self.dir)
        write_text(os.path.join(folder, "in.lj"), lammps_melt("\n".join(dumps), cells=4, steps=100))
        process = subprocess.Popen([LMP, "-in", "in.lj", "-log", "none"], cwd=folder, stdout=subprocess.PIPE,
                                   stderr=subprocess.STDOUT, text=True, env=dict(os.environ, OMP_NUM_THREADS="1"))
        return folder, process

    def test_a_run_drives_the_service_through_a_fifo(self):
        fifo = self.fifo()
        process = self.stream("lj", "--parts", 4, "--tolerance", 0.05, "--format", "lammpstrj", fifo, "--json")
        folder, solver = self.lammps(f"dump 1 all custom 10 {fifo} id type x y z", "dump 2 all custom 10 all id x y z")
        out, _ = self.ended(process)
        self.ended(solver)
        self.assertEqual(json.loads(out)["steps"], 11)
        self.assertEqual(self.steps("lj"), list(range(0, 101, 10)))
        # As the same frames from a file.
        self.service.json("replay", "file", os.path.join(folder, "all"), "--parts", 4, "--tolerance", 0.05)
        same = [[r[field] for field in ("n", "error", "epoch", "drifted", "moved")]
                for name in ("lj", "file") for r in self.service.json("history", name)]
        self.assertEqual(same[:11], same[11:])
        self.assertEqual(*(self.service.json("cuts", name)["hash"] for name in ("lj", "file")))

    def test_what_lammps_writes_is_read(self):
        folder, solver = self.lammps(
            "dump 1 all custom 50 plain id x y z", "dump 2 all atom 50 scaled", "dump_modify 2 time yes units yes",
            "dump 3 all custom 50 unwrapped.gz xu id yu zu", "dump 4 all xyz 50 run.xyz", "dump_modify 4 sort id")
        self.ended(solver)
        positions = {}
        for name in ("plain", "scaled", "unwrapped.gz", "run.xyz"):
            self.service.json("replay", name, os.path.join(folder, name), "--parts", 3)
            self.assertEqual(len(self.steps(name)), 3, name)
            positions[name] = self.held(name)[1]
        side = 4 * (4 / 0.8442) ** (1 / 3)
        for name in ("scaled", "unwrapped.gz", "run.xyz"):
            apart = positions[name] - positions["plain"]
            np.testing.assert_allclose(apart - side * np.round(apart / side), 0, atol=2e-4, err_msg=name)


if __name__ == "__main__":
    unittest.main(verbosity=2)
